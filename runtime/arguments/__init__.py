"""What the command line takes: one function for each command, with its examples. Standard library only."""
