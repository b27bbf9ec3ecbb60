"""What every DeepSeis package shares; imports no sibling."""
