"""Recordings worked out afterwards: gravity along repeated lines, RTK of files."""
