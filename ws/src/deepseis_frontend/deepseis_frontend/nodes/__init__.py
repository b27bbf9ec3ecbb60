"""The nodes of deepseis_frontend: thin shells around its algorithms."""
