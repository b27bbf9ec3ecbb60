"""The nodes of deepseis_tracking: thin shells around its algorithms."""
