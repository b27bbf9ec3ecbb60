"""The nodes of deepseis_sim: thin shells around its algorithms."""
