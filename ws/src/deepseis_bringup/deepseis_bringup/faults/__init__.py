"""Faults put into recordings, and what the station made of them."""
