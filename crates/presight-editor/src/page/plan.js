// The plan from above: walls, the robot with its field of view, and the map of what the layer is worth.

import { ofMap } from './colours.js';
import { axes } from './pose.js';

const plan = /** @type {HTMLCanvasElement} */ (document.getElementById('plan'));

/** @type {{bounds: number[][]|null, pieces: Float32Array, cells: Map<string, any>, spacing: number, coarse: number, of: number, pose: number[], fov: number}} */
const shown = { bounds: null, pieces: new Float32Array(), cells: new Map(), spacing: 1, coarse: 1, of: 6, pose: [0, 0, 0, 0, 0, 0], fov: 60 };

/** @param {Partial<typeof shown>} changes */
export function set(changes) {
  Object.assign(shown, changes);
  draw();
}

/** The scale of the map's colours, over the values that are known. */
function scale() {
  const values = [...shown.cells.values()].map(c => c[shown.of]).filter(v => v !== null && v > 0).sort((a, b) => a - b);
  if (!values.length) return { low: 0, high: 1, logarithmic: false };
  const [low, high] = [values[Math.floor(0.002 * (values.length - 1))], values[Math.ceil(0.998 * (values.length - 1))]];
  const top = high > low * 1.001 ? high : low * 1.001;
  return { low, high: top, logarithmic: top > 6 * low };
}

/** From metres to the canvas. */
function frame() {
  const [[x0, y0], [x1, y1]] = shown.bounds ?? [[0, 0], [1, 1]];
  const [w, h] = [Math.max(x1 - x0, 1e-3), Math.max(y1 - y0, 1e-3)];
  const s = Math.min((plan.width - 16) / w, (plan.height - 30) / h);
  const [left, top] = [(plan.width - s * w) / 2, 8];
  return { s, x: (/** @type {number} */ x) => left + (x - x0) * s, y: (/** @type {number} */ y) => top + (y1 - y) * s, left, top };
}

export function draw() {
  const c = /** @type {CanvasRenderingContext2D} */ (plan.getContext('2d'));
  const to = frame();
  c.fillStyle = '#101216';
  c.fillRect(0, 0, plan.width, plan.height);
  const colours = scale();
  // Until the map is whole, the places of its coarse grids stand for those around them.
  for (const step of [4, 2, 1].filter(n => n <= shown.coarse)) {
    const side = step * shown.spacing * to.s;
    for (const cell of shown.cells.values()) {
      const own = (cell[0] | cell[1]) % 4 === 0 ? 4 : (cell[0] | cell[1]) % 2 === 0 ? 2 : 1;
      if (own < step || (own > step && step < shown.coarse)) continue;
      c.fillStyle = ofMap(cell[shown.of], colours);
      c.fillRect(to.x(cell[2]) - side / 2, to.y(cell[3]) - side / 2, Math.max(1, side - 0.6), Math.max(1, side - 0.6));
    }
  }
  c.strokeStyle = '#c8cdd6';
  c.lineWidth = 1;
  c.beginPath();
  for (let i = 0; i < shown.pieces.length; i += 4) {
    c.moveTo(to.x(shown.pieces[i]), to.y(shown.pieces[i + 1]));
    c.lineTo(to.x(shown.pieces[i + 2]), to.y(shown.pieces[i + 3]));
  }
  c.stroke();
  drawRobot(c, to);
  if (shown.cells.size) drawScale(c, colours);
}

/** @param {CanvasRenderingContext2D} c @param {ReturnType<typeof frame>} to */
function drawRobot(c, to) {
  const [x, y] = [to.x(shown.pose[0]), to.y(shown.pose[1])];
  const { forward } = axes(shown.pose);
  const yaw = Math.atan2(forward[1], forward[0]);
  const half = Math.min(180, shown.fov / 2) * Math.PI / 180;
  c.fillStyle = '#35d0ff44';
  c.beginPath();
  if (half < 3.1) c.moveTo(x, y);
  c.arc(x, y, 46, -yaw - half, -yaw + half);
  c.fill();
  c.fillStyle = '#35d0ff';
  c.strokeStyle = '#fff';
  c.beginPath();
  c.arc(x, y, 6, 0, 7);
  c.fill();
  c.stroke();
}

/** @param {CanvasRenderingContext2D} c @param {{low: number, high: number, logarithmic: boolean}} colours */
function drawScale(c, colours) {
  const [left, top, width] = [120, plan.height - 16, plan.width - 330];
  for (let i = 0; i < width; i++) {
    const s = i / width;
    const v = colours.logarithmic ? colours.low * (colours.high / colours.low) ** s : colours.low + s * (colours.high - colours.low);
    c.fillStyle = ofMap(v, colours);
    c.fillRect(left + i, top, 1, 10);
  }
  c.fillStyle = '#c8cdd6';
  c.font = '13px system-ui';
  const unit = shown.of === 6 ? 'm' : 'deg';
  c.textAlign = 'right';
  c.fillText(`1 sd  ${Number(colours.low.toPrecision(2))} ${unit}`, left - 8, top + 10);
  c.textAlign = 'left';
  c.fillText(`${Number(colours.high.toPrecision(2))} ${unit}`, left + width + 8, top + 10);
  c.fillStyle = ofMap(null, colours);
  c.fillRect(left + width + 78, top, 10, 10);
  c.fillStyle = '#c8cdd6';
  c.fillText('not fixed', left + width + 94, top + 10);
}

/** @param {(x: number, y: number) => void} go */
export function start(go) {
  plan.addEventListener('click', event => {
    const box = plan.getBoundingClientRect();
    const to = frame();
    const [px, py] = [((event.clientX - box.left) / box.width) * plan.width, ((event.clientY - box.top) / box.height) * plan.height];
    const [[x0], [, y1]] = shown.bounds ?? [[0], [0, 0]];
    go(x0 + (px - to.left) / to.s, y1 - (py - to.top) / to.s);
  });
}
