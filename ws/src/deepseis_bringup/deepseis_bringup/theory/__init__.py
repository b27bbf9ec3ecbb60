"""The theory of the loops, redrawn."""
