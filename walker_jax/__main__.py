"""`python -m walker_jax` is the command `walker-jax`."""

from walker_jax.cli.main import main

if __name__ == "__main__":
    main()
