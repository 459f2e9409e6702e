// The picture: the image in its colours, and over it the lines of features.

import { HIDDEN, MISS, REGION, SEEN, byDistance, colours, darker, grey } from './colours.js';

const BORDER = 0.45;
const PICK = '#35d0ff';
const f = Math.fround;

/** @param {string} id */
const canvas = id => /** @type {HTMLCanvasElement} */ (document.getElementById(id));
const image = canvas('image');
const lines = canvas('lines');
const bar = canvas('bar');
const beside = canvas('measured');
const stage = /** @type {HTMLElement} */ (document.getElementById('stage'));

/** How much a border between polygons darkens, where each 9 x 9 pixels hold this many. @param {Uint32Array} ids @param {number} w @param {number} h */
function borders(ids, w, h) {
  const sums = new Uint32Array((w + 1) * (h + 1));
  for (let y = 0, at = 0; y < h; y++) {
    let row = 0;
    for (let x = 0; x < w; x++, at++) {
      if ((x > 0 && ids[at] !== ids[at - 1]) || (y > 0 && ids[at] !== ids[at - w])) row++;
      sums[(y + 1) * (w + 1) + x + 1] = sums[y * (w + 1) + x + 1] + row;
    }
  }
  const reach = 4;
  return (/** @type {number} */ at) => {
    const x = at % w, y = (at - x) / w;
    const [x0, x1] = [Math.max(0, x - reach), Math.min(w, x + reach + 1)];
    const [y0, y1] = [Math.max(0, y - reach), Math.min(h, y + reach + 1)];
    const s = (/** @type {number} */ i, /** @type {number} */ j) => sums[j * (w + 1) + i];
    const crowding = f(f(s(x1, y1) + s(x0, y0) - s(x0, y1) - s(x1, y0)) / f((x1 - x0) * (y1 - y0)));
    const weight = f(1 - f(f(crowding - f(0.3)) / f(0.4)));
    return BORDER * Math.min(1, Math.max(f(0.15), weight));
  };
}

/**
 * Draws a frame's image. Every pixel has the command's colour.
 * @param {any} frame
 * @param {string} output
 */
export function drawImage(frame, output) {
  const [W, H] = frame.screen.size;
  if (image.width !== W || image.height !== H) {
    for (const c of [image, lines]) [c.width, c.height] = [W, H];
    fit();
  }
  const colour = colours(output, frame[output], frame.screen);
  draw(frame, colour, image);
  drawBar(frame.screen, output);
}

/**
 * Draws the measured ranges in the colours of the predicted ones.
 * @param {any} measured
 * @param {any} frame
 */
export function drawMeasured(measured, frame) {
  const screen = frame.screen.above ? frame.screen : measured.screen;
  [beside.width, beside.height] = screen.size;
  const scale = frame.range ? { ...frame.screen, size: screen.size } : measured.screen;
  draw({ ...measured, screen }, colours('range', measured.range, scale), beside);
}

/** @param {any} frame @param {Uint32Array} colour @param {HTMLCanvasElement} to */
function draw(frame, colour, to) {
  if (frame.screen.above) drawAbove(frame, colour, to);
  else drawGrid(frame, colour, to);
}

/** @param {any} frame @param {Uint32Array} colour @param {HTMLCanvasElement} to */
function drawGrid(frame, colour, to) {
  const [W, H] = [to.width, to.height];
  const [w, h] = frame.size;
  const ids = frame.polygon_id;
  const weight = ids && borders(ids, w, h);
  const context = /** @type {CanvasRenderingContext2D} */ (to.getContext('2d'));
  const data = context.createImageData(W, H);
  const out = new Uint32Array(data.data.buffer);
  const columns = new Uint32Array(W);
  for (let x = 0; x < W; x++) {
    const c = Math.floor((x * w) / W);
    columns[x] = frame.screen.mirrored ? w - 1 - c : c;
  }
  let above = -1;
  for (let y = 0, at = 0; y < H; y++) {
    const row = Math.floor((y * h) / H) * w;
    const first = y > 0 && above !== row;
    for (let x = 0; x < W; x++, at++) {
      const here = row + columns[x];
      out[at] = colour[here];
      if (!ids) continue;
      const id = ids[here];
      if ((x > 0 && id !== ids[row + columns[x - 1]]) || (first && id !== ids[above + columns[x]])) {
        out[at] = darker(colour[here], weight(here));
      }
    }
    above = row;
  }
  context.putImageData(data, 0, 0);
}

/** A scan of one row, from above. @param {any} frame @param {Uint32Array} colour @param {HTMLCanvasElement} to */
function drawAbove(frame, colour, to) {
  const context = /** @type {CanvasRenderingContext2D} */ (to.getContext('2d'));
  const { origin: [ox, oy], pixels_per_metre: scale } = frame.screen.above;
  const at = (/** @type {number} */ i) => {
    const r = frame.range[i];
    return Number.isFinite(r) ? [ox - frame.rays[2 * i + 1] * r * scale, oy - frame.rays[2 * i] * r * scale] : null;
  };
  context.fillStyle = `rgb(${MISS.join()})`;
  context.fillRect(0, 0, to.width, to.height);
  const hits = Array.from(frame.range, (_, i) => at(i));
  context.fillStyle = '#39414e';
  context.beginPath();
  hits.forEach((hit, i) => {
    const next = hits[(i + 1) % hits.length];
    if (!hit || !next || (i + 1 === hits.length && hits.length < 3)) return;
    const [a, b] = [i, (i + 1) % hits.length].map(k => Math.atan2(frame.rays[2 * k + 1], frame.rays[2 * k]));
    // A gap without rays is not free space.
    if (Math.abs(Math.sin((a - b) / 2)) > Math.sin(1.5 * Math.PI / hits.length)) return;
    context.moveTo(ox, oy);
    context.lineTo(hit[0], hit[1]);
    context.lineTo(next[0], next[1]);
  });
  context.fill();
  rings(context, ox, oy, scale);
  hits.forEach((hit, i) => {
    if (!hit) return;
    const c = colour[i];
    context.strokeStyle = context.fillStyle = `rgb(${c & 255},${(c >> 8) & 255},${(c >> 16) & 255})`;
    const next = hits[i + 1];
    if (next && frame.polygon_id?.[i] === frame.polygon_id?.[i + 1]) {
      context.lineWidth = 3;
      context.beginPath();
      context.moveTo(hit[0], hit[1]);
      context.lineTo(next[0], next[1]);
      context.stroke();
    }
    context.beginPath();
    context.arc(hit[0], hit[1], 2.5, 0, 7);
    context.fill();
  });
  context.strokeStyle = '#c8cdd6';
  context.lineWidth = 2;
  context.beginPath();
  [[0, -11], [7, 8], [0, 4], [-7, 8], [0, -11]].forEach(([x, y]) => context.lineTo(ox + x, oy + y));
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {number} ox @param {number} oy @param {number} scale */
function rings(context, ox, oy, scale) {
  const rough = Math.max(image.width, image.height) / scale / 7;
  const base = 10 ** Math.floor(Math.log10(rough));
  const step = ([1, 2, 5, 10].find(d => d * base >= rough) ?? 10) * base;
  context.strokeStyle = '#6a728066';
  context.fillStyle = '#6a7280';
  context.font = '13px system-ui';
  context.lineWidth = 1;
  for (let i = 1; i <= 16; i++) {
    context.beginPath();
    context.arc(ox, oy, i * step * scale, 0, 7);
    context.stroke();
    context.fillText(`${Number((i * step).toPrecision(3))} m`, ox + 4, oy - i * step * scale - 4);
  }
}

/** @param {any} screen @param {string} output */
function drawBar(screen, output) {
  const context = /** @type {CanvasRenderingContext2D} */ (bar.getContext('2d'));
  const width = (bar.width = 420);
  const metres = output === 'range' || output === 'depth_z';
  const shown = metres || output === 'cos_incidence' || output === 'echo';
  bar.style.visibility = shown ? 'visible' : 'hidden';
  if (!shown) return;
  for (let x = 0; x < width; x++) {
    context.fillStyle = `rgb(${(metres ? byDistance : grey)(x / (width - 1)).join()})`;
    context.fillRect(x, 0, 1, 14);
  }
  context.fillStyle = '#c8cdd6';
  context.font = '12px system-ui';
  let free = 0;
  for (const [value, label] of screen.ticks) {
    const { low, high, logarithmic } = screen;
    const s = logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    const words = metres ? `${label} m` : label;
    const size = context.measureText(words).width;
    const x = Math.min(width - size, Math.max(0, s * (width - 1) - size / 2));
    if (x < free) continue;
    context.fillRect(s * (width - 1), 14, 1, 4);
    context.fillText(words, x, 30);
    free = x + size + 8;
  }
}

/** Scales the picture to the room there is. */
export function fit() {
  const scale = Math.min(stage.clientWidth / image.width, stage.clientHeight / image.height);
  for (const c of [image, lines]) {
    c.style.width = `${Math.max(1, Math.floor(image.width * scale))}px`;
    c.style.height = `${Math.max(1, Math.floor(image.height * scale))}px`;
  }
}

/**
 * Lines of features as paths, from an answer's list and corners.
 * @param {any} answer
 * @returns {{feature: number, style: string, corners: Float32Array}[]}
 */
export function strokes(answer) {
  let at = 0;
  return (answer.strokes ?? []).map((/** @type {[number, string, number]} */ [feature, style, count]) => {
    const corners = answer.corners.subarray(2 * at, 2 * (at + count));
    at += count;
    return { feature, style, corners };
  });
}

/** @typedef {ReturnType<typeof strokes>} Strokes */

/** @param {CanvasRenderingContext2D} context @param {Float32Array} corners @param {number} radius */
function path(context, corners, radius) {
  context.beginPath();
  if (corners.length === 2) {
    context.arc(corners[0], corners[1], radius, 0, 7);
    context.fill();
    return;
  }
  for (let i = 0; i < corners.length; i += 2) context.lineTo(corners[i], corners[i + 1]);
  context.stroke();
}

/**
 * Draws the lines over the image.
 * @param {{features: Strokes, regions: Strokes, age: number, selected: Set<number>, candidates: Strokes, candidate: number}} what
 */
export function drawLines({ features, regions, age, selected, candidates, candidate }) {
  const context = /** @type {CanvasRenderingContext2D} */ (lines.getContext('2d'));
  const unit = image.width / Math.max(1, image.clientWidth);
  context.clearRect(0, 0, lines.width, lines.height);
  context.lineCap = 'round';
  for (const { feature, style, corners } of features) {
    const on = selected.has(feature);
    context.setLineDash(style === 'seen' ? [] : [7, 7]);
    context.strokeStyle = context.fillStyle = on ? '#fff' : style === 'hidden' ? HIDDEN : SEEN;
    context.lineWidth = on ? Math.max(4, 3 * unit) : style === 'seen' ? 2 : 1.3;
    path(context, corners, on ? 6 : style === 'seen' ? 4 : 2);
  }
  context.setLineDash([]);
  // Hundreds of boxes would hide the image: the more there are, the fainter all but those of what is chosen.
  const faint = Math.max(0.12, Math.min(0.9, 40 / (regions.length + 1)));
  context.strokeStyle = REGION;
  for (const { feature, corners } of regions) {
    const on = selected.has(feature);
    context.globalAlpha = age * (on ? 1 : faint);
    context.lineWidth = Math.max(0.9, (on ? 1.6 : 0.8) * unit);
    path(context, corners, 1);
  }
  context.globalAlpha = 1;
  for (const { feature, corners } of candidates) {
    const on = feature === candidate;
    context.strokeStyle = context.fillStyle = on ? PICK : `${PICK}66`;
    context.lineWidth = (on ? 4 : 1.5) * Math.max(1, unit);
    path(context, corners, on ? 7 : 3);
  }
}

/** The picture's position of a pointer. @param {MouseEvent} event */
export function place(event) {
  const box = image.getBoundingClientRect();
  return [((event.clientX - box.left) / box.width) * image.width, ((event.clientY - box.top) / box.height) * image.height];
}

/** The sensor's pixel at a position of the picture, as column and row; null outside. @param {any} frame @param {number[]} at @param {number[]} size */
export function pixel(frame, [x, y], [w, h]) {
  if (!(x >= 0 && y >= 0 && x < image.width && y < image.height)) return null;
  if (frame.screen.above) {
    const { origin: [ox, oy] } = frame.screen.above;
    const wanted = Math.atan2(ox - x, oy - y);
    let best = -1, least = 0.1;
    for (let i = 0; i < w; i++) {
      const off = Math.abs(Math.sin((Math.atan2(frame.rays[2 * i + 1], frame.rays[2 * i]) - wanted) / 2));
      if (off < least) [least, best] = [off, i];
    }
    return best < 0 ? null : [best, 0];
  }
  const c = Math.floor((x * w) / image.width);
  return [frame.screen.mirrored ? w - 1 - c : c, Math.floor((y * h) / image.height)];
}

/** The feature whose line is nearest, within some pixels of the screen; 0 if none is. @param {Strokes} all @param {number[]} at */
export function nearest(all, [x, y]) {
  let best = 0, least = (7 * image.width) / Math.max(1, image.clientWidth);
  for (const { feature, style, corners } of all) {
    if (style === 'hidden') continue;
    for (let i = 0; i + 1 < corners.length; i += 2) {
      const [ax, ay] = [corners[i], corners[i + 1]];
      const [bx, by] = i + 3 < corners.length ? [corners[i + 2], corners[i + 3]] : [ax, ay];
      const [dx, dy] = [bx - ax, by - ay];
      const t = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
      const off = Math.hypot(ax + t * dx - x, ay + t * dy - y);
      if (off < least) [least, best] = [off, feature];
    }
  }
  return best;
}

/** Features with a line inside a rectangle. @param {Strokes} all @param {number[]} a @param {number[]} b */
export function within(all, a, b) {
  const [x0, x1] = [Math.min(a[0], b[0]), Math.max(a[0], b[0])];
  const [y0, y1] = [Math.min(a[1], b[1]), Math.max(a[1], b[1])];
  const found = new Set();
  for (const { feature, style, corners } of all) {
    if (style === 'hidden') continue;
    let inside = true;
    for (let i = 0; i < corners.length; i += 2) {
      inside &&= corners[i] >= x0 && corners[i] <= x1 && corners[i + 1] >= y0 && corners[i + 1] <= y1;
    }
    if (inside) found.add(feature);
  }
  return found;
}
