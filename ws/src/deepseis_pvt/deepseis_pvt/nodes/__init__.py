"""The nodes of deepseis_pvt: thin shells around its algorithms."""
