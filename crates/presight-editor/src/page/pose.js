// Poses as x, y, z in metres and roll, pitch, yaw in degrees: fixed axes, positive pitch looks down.

/** @typedef {number[]} Pose */

/** Shortest text that reads back as the same numbers. @param {Pose} pose */
export const text = pose => pose.map(x => String(x === 0 ? 0 : x)).join(',');

/**
 * Six or seven numbers, separated by commas or blanks; null if they are not.
 * @param {string} given
 */
export function parse(given) {
  const words = given.includes(',') ? given.split(',').map(w => w.trim()) : given.trim().split(/\s+/);
  const numbers = words.map(w => (w === '' ? NaN : Number(w)));
  const sound = numbers.every(Number.isFinite) && (numbers.length === 6 || numbers.length === 7);
  return sound ? numbers : null;
}

const RAD = Math.PI / 180;

/** The sensor's axes in the world: forward, left, up. @param {Pose} pose */
export function axes(pose) {
  const [r, p, y] = pose.slice(3).map(a => a * RAD);
  const [sr, cr, sp, cp, sy, cy] = [Math.sin(r), Math.cos(r), Math.sin(p), Math.cos(p), Math.sin(y), Math.cos(y)];
  return {
    forward: [cy * cp, sy * cp, -sp],
    left: [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr],
    up: [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr],
  };
}

/** Moves along the view's heading, to the left, and up. @param {Pose} pose @param {number} ahead @param {number} left @param {number} up */
export function moved(pose, ahead, left, up) {
  const yaw = pose[5] * RAD;
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return rounded([pose[0] + c * ahead - s * left, pose[1] + s * ahead + c * left, pose[2] + up, ...pose.slice(3)]);
}

/** Turns: yaw to the left, pitch down, degrees. @param {Pose} pose @param {number} yaw @param {number} pitch */
export function turned(pose, yaw, pitch) {
  const around = ((pose[5] + yaw + 180) % 360 + 360) % 360 - 180;
  return rounded([pose[0], pose[1], pose[2], pose[3], Math.max(-89.9, Math.min(89.9, pose[4] + pitch)), around]);
}

/** Turns about the point this far ahead. @param {Pose} pose @param {number} away @param {number} yaw @param {number} pitch */
export function orbited(pose, away, yaw, pitch) {
  const next = turned(pose, yaw, pitch);
  const [before, after] = [axes(pose).forward, axes(next).forward];
  return rounded([0, 1, 2].map(i => pose[i] + away * (before[i] - after[i])).concat(next.slice(3)));
}

/** Moves to the left and up along the image. @param {Pose} pose @param {number} left @param {number} up */
export function panned(pose, left, up) {
  const { left: l, up: u } = axes(pose);
  return rounded([0, 1, 2].map(i => pose[i] + left * l[i] + up * u[i]).concat(pose.slice(3)));
}

/** Tenths of millimetres and thousandths of degrees: what people read. @param {Pose} pose */
export const rounded = pose => pose.map((x, i) => Math.round(x * (i < 3 ? 1e4 : 1e3)) / (i < 3 ? 1e4 : 1e3));
