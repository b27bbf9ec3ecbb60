"""Bags: written so that a crash takes a quarter of a second, read, described, mended."""
