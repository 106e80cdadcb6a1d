// The view and the lattice of cells under it. Places are counted in cells of level 0 from the lower
// corner of the home window: so panning and zooming are exact, however far in.

/** The view nearest to another that can be shown. */
export function clampView({ home, levels, farthest }, { centre, zoom }) {
  const between = (low, value, high) => Math.min(high, Math.max(low, value));
  return {
    centre: centre.map((c, k) => between((-farthest / 2) * home[k], c, (farthest / 2) * home[k])),
    zoom: between(levels[0] + 1, zoom, levels[1] - 2),
  };
}

export class Lattice {
  constructor(about, window) {
    const { tile, home, levels } = about;
    this.about = about;
    this.tile = tile;
    this.home = home;
    this.levels = levels;
    this.lower = window.lower;
    this.upper = window.upper;
  }

  /** A coordinate of the section from a place along axis k, and back. */
  value(k, place) {
    const share = place / this.home[k];
    return this.lower[k] * (1 - share) + this.upper[k] * share;
  }

  place(k, value) {
    return ((value - this.lower[k]) / (this.upper[k] - this.lower[k])) * this.home[k];
  }

  /** The whole home window. */
  whole() {
    return { centre: this.home.map((n) => n / 2), zoom: 0 };
  }

  /** Half the extent of a view along axis k. */
  half(view, k) {
    return (this.home[k] / 2) * 2 ** -view.zoom;
  }

  /** The ends of a view along axis k. */
  ends(view, k) {
    return [view.centre[k] - this.half(view, k), view.centre[k] + this.half(view, k)];
  }

  /** The level on which the view has about as many cells as the home window has on level 0. */
  level(view) {
    return this.clamp(Math.round(view.zoom));
  }

  clamp(level) {
    return Math.min(this.levels[1], Math.max(this.levels[0], level));
  }

  /** The tiles of a level that a view shows, from the centre outwards. */
  tiles(view, level) {
    const size = this.tile * 2 ** -level;
    const range = (k) => this.ends(view, k).map((end) => Math.floor(end / size));
    const [i0, i1] = range(0), [j0, j1] = range(1);
    const middle = view.centre.map((c) => c / size - 0.5);
    const found = [];
    for (let i = i0; i <= i1; i++) for (let j = j0; j <= j1; j++) found.push([level, i, j]);
    const far = ([, i, j]) => Math.hypot(i - middle[0], j - middle[1]);
    return found.sort((a, b) => far(a) - far(b));
  }

  /** The cells of a level that cover a view: [level, i, j, columns, rows]. */
  rectangle(view, level) {
    const scale = 2 ** level;
    const ends = [0, 1].map((k) => {
      const [low, high] = this.ends(view, k);
      return [Math.floor(low * scale + 1e-6), Math.ceil(high * scale - 1e-6)];
    });
    return [level, ends[0][0], ends[1][0], ends[0][1] - ends[0][0], ends[1][1] - ends[1][0]];
  }

  /** The area of a cell of a level, in the section's own coordinates: a shear keeps it. */
  cellArea(level) {
    const width = (k) => (this.upper[k] - this.lower[k]) / this.home[k];
    return (width(0) * width(1)) / 4 ** level;
  }
}
