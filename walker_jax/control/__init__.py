"""The limits of control: viability, and policies for three objectives."""
