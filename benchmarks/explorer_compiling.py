"""How long does the explorer compile before it shows a walker for the first time?

Each walker, and each other system, in a process of its own with empty caches. The table
`SECONDS` of `walker_jax/explorer/compile_times.py` has these, rounded: the page says them while a
walker is compiled. On two cores that others used too:

    simplest             3.2 s     henon                0.7 s
    spring               3.7 s     duffing              2.7 s
    point-foot           7.7 s     bouncing-ball        1.5 s
    round-foot           9.3 s     impact-oscillator    2.4 s
    upper-body          11.7 s     torso-wheel         11.6 s
    kneed               32.6 s     five-link-biped     24.1 s
    powered              4.9 s
    powered-point-foot  12.0 s
    powered-round-foot   9.1 s
    powered-upper-body  13.1 s
"""

import os
import subprocess
import sys
import tempfile
import time

import jax

from walker_jax.explorer.offers import FAMILY, OTHERS
from walker_jax.explorer.programs import compile_programs
from walker_jax.explorer.subjects import read_subject


def main() -> None:
    if len(sys.argv) > 1:
        jax.config.update("jax_enable_x64", True)
        subject = read_subject({"walker": sys.argv[1]}, FAMILY | OTHERS)
        start = time.monotonic()
        compile_programs(subject)
        print(f"{sys.argv[1]:18} {time.monotonic() - start:5.1f} s", flush=True)
        return
    for name in FAMILY | OTHERS:
        with tempfile.TemporaryDirectory() as folder:
            empty = {"WALKER_JAX_CACHE_DIR": folder, "JAX_COMPILATION_CACHE_DIR": folder}
            subprocess.run([sys.executable, __file__, name], env=os.environ | empty, check=True)


if __name__ == "__main__":
    main()
