// Colours of cells: those of the figures on a light page, and on a dark one the same with inverted
// lightness, so that contrast stays the same.

const CHROMA = 0.8; // of an inverted colour: less, as it glows on a dark page
const BOTH = 106; // the sum of a colour's lightness on both pages: above 100, as a dark page is not black

export class Palette {
  constructor(about) {
    this.about = about;
    this.use(false);
  }

  /** Compute all colours, for a dark page or a light one. */
  use(dark) {
    this.dark = dark;
    const shown = (colour) => (dark ? turned(parse(colour)) : parse(colour));
    const { walkers, basins, unmatched, others, artefacts, labels } = this.about;
    const own = Object.values(walkers).map((one) => one.fates); // which have the same colours in all
    const fates = Object.assign({}, this.about.fates, ...own);
    this.fates = Object.fromEntries(Object.entries(fates).map(([code, one]) => [code, shown(one.colour)]));
    this.basins = basins.map(shown);
    this.others = shown(others);
    this.unmatched = shown(unmatched);
    this.artefacts = shown(artefacts);
    this.first = labels.first;
    this.none = labels.unmatched;
    this.page = dark ? [20, 22, 27] : [251, 250, 248];
    this.attractors = [];
  }

  /** The colour of a label; attractors are told apart by their number. */
  colour(label, attractors = []) {
    if (label === this.none) return this.unmatched;
    if (label < this.first) return this.fates[label] ?? this.unmatched;
    if (attractors[label - this.first]?.artefact) return this.artefacts;
    return this.basins[label - this.first] ?? this.others;
  }

  /** The colours of all labels and strides, as pixels of an image. */
  table(attractors) {
    const key = `${this.dark} ${attractors.map((one) => Number(one.artefact)).join("")}`;
    if (this.key === key) return this.pixels;
    this.key = key;
    this.pixels = new Uint32Array(256 * 256);
    for (let label = 0; label < 256; label++) {
      const colour = this.colour(label, attractors);
      for (let strides = 0; strides < 256; strides++) {
        const [r, g, b] = this.shaded(colour, label, strides);
        this.pixels[label * 256 + strides] = (255 << 24) | (b << 16) | (g << 8) | r;
      }
    }
    return this.pixels;
  }

  /** Colours of a label from the fullest on, for numbers of strides from one of its `FADES` to the other. */
  scale(label, count = 8) {
    const [low, high] = label >= this.none ? FADES.walks : FADES.falls;
    const strides = (k) => Math.round((low + 1) * ((high + 1) / (low + 1)) ** (k / (count - 1)) - 1);
    return Array.from({ length: count }, (_, k) => css(this.shaded(this.colour(label), label, strides(k))));
  }

  /** Fewer strides, a fuller colour: between `FADES`. */
  shaded(colour, label, strides) {
    const walks = label >= this.none;
    const slow = walks ? Math.log2(Math.max(strides, 8) / 8) / 4.3 : Math.log2(1 + strides) / 6;
    const share = Math.min(1, slow) * (walks ? 0.42 : 0.3);
    const towards = walks ? this.page : this.dark ? [0, 0, 0] : [112, 104, 92];
    return colour.map((value, i) => Math.round(value + share * (towards[i] - value)));
  }
}

/** The strides between which colours fade: of basins, and of falls. */
export const FADES = { walks: [8, 160], falls: [0, 63] };

export const css = ([r, g, b], alpha = 1) => `rgba(${r}, ${g}, ${b}, ${alpha})`;

function parse(hex) {
  return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
}

/** The colour with its lightness turned over: the hue is that of OKLab (Ottosson 2020). */
function turned(rgb) {
  const [, a, b] = toLab(rgb), wanted = BOTH - lightness(rgb);
  const made = (L) => fromLab([L, CHROMA * a, CHROMA * b]);
  let low = 0, high = 1;
  for (let k = 0; k < 14; k++) {
    const middle = (low + high) / 2;
    if (lightness(made(middle)) < wanted) low = middle;
    else high = middle;
  }
  return made(high);
}

const linear = (rgb) => rgb.map((v) => (v <= 10.31 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));

/** CIE L*, from 0 for black to 100 for white: by it colours differ for all eyes, also in grey. */
function lightness(rgb) {
  const [r, g, b] = linear(rgb);
  return 116 * Math.cbrt(0.2126 * r + 0.7152 * g + 0.0722 * b) - 16;
}

function toLab(rgb) {
  const [r, g, b] = linear(rgb);
  const l = Math.cbrt(0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b);
  const m = Math.cbrt(0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b);
  const s = Math.cbrt(0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b);
  return [
    0.2104542553 * l + 0.793617785 * m - 0.0040720468 * s,
    1.9779984951 * l - 2.428592205 * m + 0.4505937099 * s,
    0.0259040371 * l + 0.7827717662 * m - 0.808675766 * s,
  ];
}

function fromLab([L, a, b]) {
  const l = (L + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (L - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (L - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const rgb = [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
  return rgb.map((v) => {
    const gamma = v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055;
    return Math.round(255 * Math.min(1, Math.max(0, gamma)));
  });
}
