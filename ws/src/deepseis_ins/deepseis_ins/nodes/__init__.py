"""The nodes of deepseis_ins: thin shells around its algorithms."""
