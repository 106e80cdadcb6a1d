"""The command `walker-jax`: one file a command."""
