"""Acquisition, tracking loops and navigation data of the satellites."""
