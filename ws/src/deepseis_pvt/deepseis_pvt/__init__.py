"""From tracking epochs to observations, positions and displacement."""
