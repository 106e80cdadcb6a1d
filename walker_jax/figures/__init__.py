"""Pictures of results: one function per picture, which draws a data set and returns its Axes.

Each function draws a data set of a kind that `walker_jax.storage.schema` lists, and computes
nothing but the layout. It draws on `ax`, or on a new figure outside any window and outside pyplot:
`figures.basin(data).figure.savefig("basin.png", dpi=150)`. Sizes of text are those of matplotlib's
`rcParams`. Given axes need a figure with a layout, as from
`plt.subplots(1, 2, layout="constrained")`, with 5 by 4.4 inches or more for each. Words around a
picture can be left out, as `Style` says: `figures.basin(data, ax, legend=False)`. Angles are in rad
and times in sqrt(l / g), with leg length l and gravity g. Colours differ in lightness as well as
hue, so that they can be told apart in grey print and by the colour-blind.
"""

from walker_jax.lazy_names import load_lazily

__getattr__, __dir__, __all__ = load_lazily(globals())  # pyright: ignore[reportUnsupportedDunderAll] (from the stub)
