"""Walking: the swing, the stride function and its iteration, margins, motions."""
