// The command's colours of values: the same numbers as in its pictures.

/** @typedef {{low: number, high: number, logarithmic: boolean}} Scale */

const VIRIDIS = [
  [0x48, 0x24, 0x75], [0x41, 0x44, 0x87], [0x35, 0x5f, 0x8d], [0x2a, 0x78, 0x8e], [0x21, 0x91, 0x8c],
  [0x22, 0xa8, 0x84], [0x44, 0xbf, 0x70], [0x7a, 0xd1, 0x51], [0xbd, 0xdf, 0x26], [0xfd, 0xe7, 0x25],
];
export const MISS = [0x26, 0x2a, 0x33];
export const TOO_NEAR = [0x8c, 0x2f, 0x39];
export const NO_RAY = [0x0b, 0x0c, 0x0f];
export const SEEN = '#ff4fd8';
export const HIDDEN = '#ff8f2e';
export const REGION = '#f2f4f8';

/** @param {number} x */
const round = x => Math.floor(x + 0.5);

/** @param {number[]} a @param {number[]} b @param {number} share */
export const mix = (a, b, share) => a.map((c, i) => round(c + share * (b[i] - c)));

/** @param {number} x */
const clamp = x => Math.min(1, Math.max(0, x));

/** Near (0) is light yellow, far (1) dark violet. @param {number} share */
export function byDistance(share) {
  const at = clamp(1 - share) * (VIRIDIS.length - 1);
  const i = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return mix(VIRIDIS[i], VIRIDIS[i + 1], at - i);
}

/** @param {number} share */
export const grey = share => Array(3).fill(round(clamp(share) * 255));

/** @param {number} id */
export function byId(id) {
  const hue = ((id * 0.618033988749895) % 1) * 2 * Math.PI;
  const lightness = [0.70, 0.80, 0.60][(Math.imul(id, 0x9e3779b9) >>> 16) % 3];
  return oklab(lightness, 0.12 * Math.cos(hue), 0.12 * Math.sin(hue));
}

/** OKLab (Ottosson 2020) to sRGB. @param {number} l @param {number} a @param {number} b */
function oklab(l, a, b) {
  const cube = (/** @type {number} */ x) => x * x * x;
  const long = cube(l + 0.3963377774 * a + 0.2158037573 * b);
  const medium = cube(l - 0.1055613458 * a - 0.0638541728 * b);
  const short = cube(l - 0.0894841775 * a - 1.2914855480 * b);
  return [
    4.0767416621 * long - 3.3077115913 * medium + 0.2309699292 * short,
    -1.2684380046 * long + 2.6097574011 * medium - 0.3413193965 * short,
    -0.0041960863 * long - 0.7034186147 * medium + 1.7076147010 * short,
  ].map(c => {
    const v = clamp(c);
    return round((v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055) * 255);
  });
}

/** @param {Scale} scale @param {number} value */
export function share({ low, high, logarithmic }, value) {
  return clamp(logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
}

/** @param {number[]} c */
const packed = ([r, g, b]) => (0xff000000 | (b << 16) | (g << 8) | r) >>> 0;

/** Colours of ids that were shown before. @type {Map<number, number>} */
const ids = new Map();

/**
 * The colour of each pixel, as ABGR.
 * @param {string} output
 * @param {Float32Array|Uint32Array} values
 * @param {Scale} scale
 */
export function colours(output, values, scale) {
  const isVector = output === 'normal';
  const count = isVector ? values.length / 3 : values.length;
  const out = new Uint32Array(count);
  const [miss, near, none] = [packed(MISS), packed(TOO_NEAR), packed(NO_RAY)];
  if (values instanceof Uint32Array) {
    let last = -1, colour = 0;
    for (let i = 0; i < count; i++) {
      const id = values[i];
      if (id !== last) {
        colour = ids.get(id) ?? packed(id === 0 ? MISS : byId(id));
        ids.set(id, colour);
        last = id;
      }
      out[i] = colour;
    }
    return out;
  }
  if (isVector) {
    const of = (/** @type {number} */ v) => Number.isNaN(v) ? 0 : Math.min(255, Math.max(0, round(Math.fround(127.5 * Math.fround(v + 1)))));
    for (let i = 0; i < count; i++) out[i] = packed([of(values[3 * i]), of(values[3 * i + 1]), of(values[3 * i + 2])]);
    return out;
  }
  const metres = output === 'range' || output === 'depth_z';
  const { low, high, logarithmic } = scale;
  for (let i = 0; i < count; i++) {
    const v = values[i];
    if (v !== v) out[i] = metres ? none : miss;
    else if (v === Infinity) out[i] = miss;
    else if (v === -Infinity) out[i] = near;
    else if (!metres) {
      const g = round(clamp(v) * 255);
      out[i] = (0xff000000 | (g << 16) | (g << 8) | g) >>> 0;
    } else {
      const s = clamp(logarithmic ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low));
      const at = clamp(1 - s) * 9;
      const k = at >= 8 ? 8 : at | 0;
      const [a, b, f] = [VIRIDIS[k], VIRIDIS[k + 1], at - k];
      out[i] = (0xff000000 | ((a[2] + f * (b[2] - a[2]) + 0.5) << 16) | ((a[1] + f * (b[1] - a[1]) + 0.5) << 8) | (a[0] + f * (b[0] - a[0]) + 0.5)) >>> 0;
    }
  }
  return out;
}

/** Darkens a colour towards black. @param {number} colour @param {number} by */
export function darker(colour, by) {
  const part = (/** @type {number} */ at) => {
    const c = (colour >>> at) & 255;
    return round(c + by * (0 - c));
  };
  return (0xff000000 | (part(16) << 16) | (part(8) << 8) | part(0)) >>> 0;
}

/** The colour of a value of the map. @param {number|null} value @param {Scale} scale */
export function ofMap(value, scale) {
  const colour = value === null || value === Infinity ? TOO_NEAR : byDistance(share(scale, value));
  return `rgb(${colour.join()})`;
}
