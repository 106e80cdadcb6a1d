"""The command `walker-jax`: one file for each command, loaded when that command is asked for."""
