// Views to come back to: the pose in the page's address, the browser's history, and the views that a person keeps.

import { addressOf, poseInAddress } from './carrier.js';
import * as panel from './panel.js';
import * as poses from './pose.js';

/** The views of one movement, milliseconds apart at most, share an entry of the history. */
const MOVEMENT_MS = 1500;

/** @param {string} id */
const get = id => /** @type {any} */ (document.getElementById(id));

/** @param {string} text */
function six(text) {
  const numbers = poses.parse(text);
  return numbers?.length === 6 ? numbers : null;
}

/** The pose that the page's address asks for, if it names one. */
export const asked = () => six(poseInAddress());

/** The pose whose entry is the newest of the history. */
let remembered = '';
let rememberedAt = -Infinity;

/** Puts a pose into the address: reload shows the same view, and back the one before. @param {poses.Pose} pose */
export function remember(pose) {
  const here = poses.text(pose);
  if (here === remembered) return;
  const isMovement = performance.now() - rememberedAt < MOVEMENT_MS;
  history[isMovement || !remembered ? 'replaceState' : 'pushState'](null, '', addressOf(here));
  [remembered, rememberedAt] = [here, performance.now()];
}

/**
 * Makes back and forward, and the buttons of kept views, lead to their poses. The browser keeps the views of a scene.
 * @param {string} scene
 * @param {() => poses.Pose} current
 * @param {(pose: poses.Pose) => void} go
 */
export function start(scene, current, go) {
  window.addEventListener('popstate', () => {
    const found = asked();
    if (!found) return;
    [remembered, rememberedAt] = [poses.text(found), -Infinity];
    go(found);
  });
  const key = `views of ${scene}`;
  /** @returns {string[]} */
  const kept = () => {
    try {
      const all = JSON.parse(localStorage.getItem(key) ?? '[]');
      return Array.isArray(all) ? all.filter(view => typeof view === 'string' && six(view)) : [];
    } catch {
      return [];
    }
  };
  const keep = (/** @type {string[]} */ all) => {
    localStorage.setItem(key, JSON.stringify(all));
    show();
  };
  const show = () => get('views').replaceChildren(...kept().map((view, i) => panel.make('button', {
    type: 'button', title: `${view}: click to go there, Alt+click to forget it`,
    onclick: (/** @type {MouseEvent} */ event) =>
      event.altKey ? keep(kept().filter((_, k) => k !== i)) : go(/** @type {poses.Pose} */ (six(view))),
  }, String(i + 1))));
  get('bookmark').addEventListener('click', () => {
    const here = poses.text(current());
    if (!kept().includes(here)) keep([...kept(), here]);
  });
  show();
}
