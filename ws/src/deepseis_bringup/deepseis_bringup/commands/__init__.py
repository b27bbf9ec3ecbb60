"""What the `deepseis` command can do: one module for each group of commands."""
