"""The papers' tables repeated: published value, ours, goal, limit."""
