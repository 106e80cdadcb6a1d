// Numbers and names as a reader expects them.

/** How the page speaks of walkers, and of systems that are none. */
export const WALKER = {
  kind: "walker", gait: "gait", stride: "stride", on: "walks on", to: "walks: at", else: "walks to another gait",
  none: "no walk goes on", aperiodic: "walks without a period", lost: "walking is lost",
  followed: "The gaits are followed over the slope", traced: "stance leg angle θ at heel strike (rad)", lose: "the fall",
};
export const SYSTEM = {
  kind: "system", gait: "cycle", stride: "iterate", on: "goes on", to: "comes to", else: "comes to another attractor",
  none: "no attractor is seen", aperiodic: "an attractor without a period", lost: "the attractors end",
  followed: "The cycles are followed over this parameter", lose: "it is lost",
};

/** A number with some significant digits, and a minus sign that is one. */
export function number(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-4 || size >= 1e6) ? power(value, digits) : trim(value.toPrecision(digits));
  return text.replace(/-/g, "−");
}

/** A number with so many decimals. */
export function decimals(value, count) {
  return value.toFixed(Math.max(0, Math.min(15, count))).replace("-", "−");
}

function trim(text) {
  return text.includes("e") ? String(Number(text)) : text;
}

const RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** Whether a number of this size is written without a power of ten. */
const isPlain = (size) => size >= 0.1 && size < 1000;

/** An area: a number, or a mantissa times a power of ten. */
export function area(value, digits = 3) {
  return isPlain(value) ? number(value, digits) : power(value, digits);
}

/** A number as a mantissa times a power of ten. */
function power(value, digits = 3) {
  const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
  const raised = [...exponent.replace("+", "")].map((c) => (c === "-" ? "⁻" : RAISED[c])).join("");
  return `${mantissa.replace("-", "−")} × 10${raised}`;
}

/** A value and its error, at the digits that the error leaves. */
export function withError(value, error) {
  if (!(error > 0)) return area(value, 3);
  const exponent = Math.floor(Math.log10(Math.abs(value) || error));
  const places = Math.max(0, Math.min(9, exponent - Math.floor(Math.log10(error)) + 1));
  if (isPlain(value)) {
    const digits = Math.max(0, 1 - Math.floor(Math.log10(error)));
    return `${decimals(value, digits)} ± ${decimals(error, digits)}`;
  }
  const scale = 10 ** exponent;
  const raised = power(scale, 1).split("× ")[1];
  return `(${decimals(value / scale, places)} ± ${decimals(error / scale, places)}) × ${raised}`;
}

/** A complex number, or a pair of conjugates as one. */
function multiplier([real, imaginary]) {
  if (imaginary === 0) return number(real, 3);
  return `${number(real, 3)} ± ${number(Math.abs(imaginary), 3)} i`;
}

/** The Floquet multipliers of a gait. */
export function multipliers(gait) {
  return gait.multipliers.filter(([, imaginary]) => imaginary >= 0).map(multiplier).join(", ");
}

export function count(n, noun, many = `${noun}s`) {
  return `${n} ${n === 1 ? noun : many}`;
}

/** The name of a parameter, as people write it. */
export function spaced(name) {
  return name.replaceAll("_", " ");
}

/** A unit in parentheses, for beside a title; none where the title ends with it, as in "hip mass". */
export function unitBeside(title, unit) {
  return unit && !title.endsWith(unit) ? `(${unit.replace("^2", "²")})` : "";
}

/** Round steps of an axis: ticks between two ends, and the decimals that tell them apart. */
export function ticks(low, high, most) {
  const rough = (high - low) / most;
  const unit = 10 ** Math.floor(Math.log10(rough));
  const step = unit * [1, 2, 5, 10].find((m) => m * unit >= rough);
  const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  const values = [];
  for (let k = first; k <= last && values.length < 50; k++) values.push(k * step);
  return { values, places };
}
