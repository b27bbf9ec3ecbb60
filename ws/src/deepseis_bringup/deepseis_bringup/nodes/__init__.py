"""The nodes of deepseis_bringup: thin shells around its algorithms."""
