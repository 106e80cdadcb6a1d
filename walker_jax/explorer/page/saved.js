// Saved pictures: the map or the diagram, its parameters above, its legend below; as PNG, or as SVG.

const FONT = "12px system-ui, sans-serif";
const LINE = 18; // CSS pixels
const EDGE = 14;
const SWATCH = 13, SCALE = 62; // widths of a colour in the legend, and of a scale of colours

/** As PNG, in the pixels of this screen, two for each of CSS at least. */
export function png(drawing) {
  const ratio = Math.max(2, devicePixelRatio || 1), canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const laid = layOut(drawing, context);
  [canvas.width, canvas.height] = [laid.width * ratio, laid.height * ratio];
  context.scale(ratio, ratio);
  paint(drawing, laid, context);
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

/** As SVG: lines and words as such, cells as an image. */
export function svg(drawing) {
  const laid = layOut(drawing, document.createElement("canvas").getContext("2d"));
  const context = new SvgContext();
  paint(drawing, laid, context);
  return new Blob([context.document(laid.width, laid.height)], { type: "image/svg+xml" });
}

/** Lines of words that fit the width, and places of the legend's entries. */
function layOut({ width, height, title, about, legend }, context) {
  const wide = (text, bold = "") => {
    context.font = bold + FONT;
    return context.measureText(text).width;
  };
  const lines = [];
  for (const part of about) {
    const longer = lines.length ? `${lines.at(-1)}, ${part}` : part;
    if (lines.length && wide(longer) <= width - 2 * EDGE) lines[lines.length - 1] = longer;
    else lines.push(part);
  }
  const top = EDGE + LINE * (1 + lines.length);
  let x = EDGE, y = top + height + LINE;
  const entries = legend.map(({ words, colours }) => {
    const swatch = colours.length > 1 ? SCALE : SWATCH, whole = swatch + 7 + wide(words);
    if (x > EDGE && x + whole > width - EDGE) [x, y] = [EDGE, y + LINE];
    const entry = { words, colours, swatch, x, y };
    x += whole + 18;
    return entry;
  });
  return { width, height: y + (legend.length ? EDGE : 0), top, title, lines, entries };
}

function paint({ draw, ground, ink }, { width, height, top, title, lines, entries }, c) {
  const write = (text, x, y, bold = "") => {
    Object.assign(c, { fillStyle: ink, font: bold + FONT, textAlign: "left", textBaseline: "alphabetic" });
    c.fillText(text, x, y);
  };
  c.fillStyle = ground;
  c.fillRect(0, 0, width, height);
  write(title, EDGE, EDGE + 8, "600 ");
  lines.forEach((line, k) => write(line, EDGE, EDGE + 8 + LINE * (k + 1)));
  c.save();
  c.translate(0, top);
  draw(c);
  c.restore();
  for (const { words, colours, swatch, x, y } of entries) {
    colours.forEach((colour, k) => {
      c.fillStyle = colour;
      c.fillRect(x + (k * swatch) / colours.length, y - 10, swatch / colours.length, SWATCH);
    });
    write(words, x + swatch + 7, y);
  }
}

const KEPT = ["fillStyle", "strokeStyle", "lineWidth", "lineJoin", "font", "textAlign", "textBaseline", "dash", "matrix", "clipped"];
const ANCHORS = { left: "start", center: "middle", right: "end" };
const LOWER = { top: 0.8, middle: 0.35, alphabetic: 0 }; // of the font's size, below the point given

/** As much of a canvas's context as the page draws with; its elements are those of an SVG. */
class SvgContext {
  constructor() {
    Object.assign(this, { fillStyle: "#000", strokeStyle: "#000", lineWidth: 1, lineJoin: "miter", font: FONT });
    Object.assign(this, { textAlign: "left", textBaseline: "alphabetic", dash: [], matrix: new DOMMatrix(), clipped: "" });
    Object.assign(this, { parts: [], saved: [], path: "", clips: 0 });
  }

  document(width, height) {
    const size = `width="${width}" height="${height}" viewBox="0 0 ${width} ${height}"`;
    return `<svg xmlns="http://www.w3.org/2000/svg" ${size}>\n${this.parts.join("\n")}\n</svg>\n`;
  }

  save() { this.saved.push(Object.fromEntries(KEPT.map((name) => [name, this[name]]))); }
  restore() { Object.assign(this, this.saved.pop()); }
  translate(x, y) { this.matrix = this.matrix.translate(x, y); }
  rotate(angle) { this.matrix = this.matrix.rotate((180 / Math.PI) * angle); }
  setLineDash(dash) { this.dash = dash; }

  beginPath() { this.path = ""; }
  moveTo(x, y) { this.path += `M${short(x)} ${short(y)}`; }
  lineTo(x, y) { this.path += `${this.path ? "L" : "M"}${short(x)} ${short(y)}`; }
  rect(x, y, width, height) { this.path += `M${short(x)} ${short(y)}h${short(width)}v${short(height)}h${short(-width)}z`; }
  arc(x, y, radius) { // the page draws whole circles only
    const half = (dx) => `a${radius} ${radius} 0 0 1 ${short(dx)} 0`;
    this.path += `M${short(x - radius)} ${short(y)}${half(2 * radius)}${half(-2 * radius)}z`;
  }

  fill() { this.add("path", { d: this.path, ...colour("fill", this.fillStyle) }); }
  stroke() { this.add("path", { d: this.path, fill: "none", ...this.pen() }); }
  fillRect(x, y, width, height) { this.add("rect", { ...box(x, y, width, height), ...colour("fill", this.fillStyle) }); }
  strokeRect(x, y, width, height) { this.add("rect", { ...box(x, y, width, height), fill: "none", ...this.pen() }); }

  clip() {
    this.clipped = `c${++this.clips}`;
    this.parts.push(`<clipPath id="${this.clipped}"><path d="${this.path}" transform="${this.matrix}"/></clipPath>`);
  }

  drawImage(canvas, x, y, width, height) {
    const href = canvas.toDataURL(), style = "image-rendering:pixelated";
    this.add("image", { ...box(x, y, width, height), href, style, preserveAspectRatio: "none" });
  }

  fillText(text, x, y) {
    const style = `font:${this.font}`, size = Number(/([\d.]+)px/.exec(this.font)[1]);
    const at = { x: short(x), y: short(y + LOWER[this.textBaseline] * size), "text-anchor": ANCHORS[this.textAlign] };
    this.add("text", { ...at, style, ...colour("fill", this.fillStyle), "xml:space": "preserve" }, text);
  }

  pen() {
    const dash = this.dash.length ? { "stroke-dasharray": this.dash.join(" ") } : {};
    return { "stroke-width": this.lineWidth, "stroke-linejoin": this.lineJoin, ...dash, ...colour("stroke", this.strokeStyle) };
  }

  add(kind, attributes, text = "") {
    const all = { ...attributes, ...(this.matrix.isIdentity ? {} : { transform: this.matrix }) };
    const words = Object.entries(all).map(([name, value]) => `${name}="${escaped(value)}"`).join(" ");
    const one = `<${kind} ${words}>${escaped(text)}</${kind}>`;
    this.parts.push(this.clipped ? `<g clip-path="url(#${this.clipped})">${one}</g>` : one);
  }
}

const short = (value) => Number(value.toFixed(2));
const box = (x, y, width, height) => ({ x: short(x), y: short(y), width: short(width), height: short(height) });
const escaped = (text) => String(text).replace(/[&<>"]/g, (one) => `&#${one.charCodeAt(0)};`);

/** A colour's attributes: its opacity apart, as not all programs read rgba(). */
function colour(name, value) {
  const [, r, g, b, alpha] = /^rgba\(([^,]+),([^,]+),([^,]+),([^)]+)\)$/.exec(value) ?? [];
  return alpha === undefined ? { [name]: value } : { [name]: `rgb(${r},${g},${b})`, [`${name}-opacity`]: alpha.trim() };
}
