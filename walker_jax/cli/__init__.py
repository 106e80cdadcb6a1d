"""The command `walker-jax`: one file for each command, loaded when that command is asked for.

A command is a function of the walker and of groups of options, which its signature names; it calls
one public function of the library, and yields its answer, for JSON, then the lines that say it in
words. `gait_command` is an example.
`options` says how options are declared, with help and checks; `commands` how click reads them and
what is refused; `section` has the options for coordinates, `walker_options` those for the walker.
Nothing loads JAX until the options are right, so commands name the library by `library`.
"""
