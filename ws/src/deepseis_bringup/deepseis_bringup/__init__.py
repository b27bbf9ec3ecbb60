"""The graph of nodes and the deepseis command."""
