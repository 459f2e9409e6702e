// The page: what is shown, what is chosen, and the messages between them and the session.

import { Behind, newest, send } from './carrier.js';
import * as list from './list.js';
import * as panel from './panel.js';
import * as picture from './picture.js';
import * as plan from './plan.js';
import * as poses from './pose.js';
import * as views from './views.js';

/** @param {string} id */
const get = id => /** @type {any} */ (document.getElementById(id));
const stage = get('stage'), poseField = get('pose'), band = get('band');

/** @type {any} */
let state = null;
let pose = [0, 0, 0, 0, 0, 0];
let output = 'range';
/** The last frame that was drawn. @type {any} */
let frame = null;
/** @type {picture.Strokes} */
let features = [];
/** @type {picture.Strokes} */
let regions = [];
/** @type {picture.Strokes} */
let candidates = [];
let regionAge = 1;
/** @type {Set<number>} */
let selected = new Set();
/** The pick: what the pixel sees and the features that it offers. @type {any} */
let pick = null;
let candidate = 0;
/** What the sensor measured, if the command was given it. @type {any} */
let measured = null;
let seq = 0;
let dragging = false;
let slow = false;
/** For tests and figures: the last numbers that were drawn. */
const drawn = /** @type {any} */ (window).presight = { seq: 0, pose: '', regions: 0, full: 0, version: 0, ms: 0, at: 0, frame: () => frame, worth: null };

// What the page says.

/** @param {string} words @param {boolean} [good] */
function say(words, good = false) {
  get('said').hidden = !words;
  get('said').className = good ? 'bar good' : 'bar';
  get('said').firstElementChild.textContent = words;
}

/** Runs what may be refused; the refusal is shown. @template T @param {() => Promise<T>} work @returns {Promise<T|undefined>} */
async function guarded(work) {
  try {
    return await work();
  } catch (e) {
    const error = /** @type {any} */ (e);
    if (error instanceof Behind) await take(error.state);
    say(error.message ?? String(error));
  }
}

// Frames.

const ask = newest(async (/** @type {{full: boolean}} */ { full }) => {
  const began = performance.now();
  const number = ++seq;
  const wanted = state.outputs.find((/** @type {any} */ o) => o.name === output);
  const needs = [output, ...wanted.needs.filter((/** @type {string} */ n) => n !== output)];
  const more = ['range', 'object_id', 'cos_incidence'].filter(n => full && !needs.includes(n));
  const asked = {
    pose, outputs: [...needs, ...more], features: get('with-seen').checked, hidden: full && get('with-hidden').checked,
    stride: slow && !full ? 2 : 1, seq: number,
  };
  const shown = output;
  const answer = await guarded(() => send('frame', asked));
  if (!answer) return;
  if (answer.version !== state.version) await guarded(async () => take(await send('state')));
  frame = answer;
  picture.drawImage(frame, shown);
  if (measured && (!dragging || shown === 'range')) picture.drawMeasured(measured, frame);
  if (frame.strokes) {
    features = picture.strokes(frame);
    list.show(frame.seen);
  } else if (frame.stride === 1) features = [];
  drawLines();
  const ms = performance.now() - began;
  if (!full) slow = asked.stride === 1 ? ms > 50 : slow && ms > 15;
  Object.assign(drawn, { seq: number, pose: poses.text(answer.pose), ms, at: performance.now(), version: answer.version });
  if (full) drawn.full = number;
  get('stats').textContent = `${frame.seen ? `${new Set(frame.seen).size} features seen, ` : ''}${frame.ms.toFixed(0)} ms + ${Math.max(0, ms - frame.ms).toFixed(0)} ms`;
});

const askRegions = newest(async (/** @type {void} */ _) => {
  if (!get('with-regions').checked || !get('with-seen').checked || !state.sensor.projects || !state.features) {
    regions = [];
    drawLines();
    return;
  }
  const [p, h, c] = ['s-position', 's-heading', 's-confidence'].map(id => Number(get(id).value));
  const asked = poses.text(pose);
  const answer = await guarded(() => send('regions', { pose, sigmas: [p, p, 0, 0, 0, h], confidence: c }));
  if (!answer) return;
  regions = picture.strokes(answer);
  regionAge = 1;
  drawLines();
  Object.assign(drawn, { regions: drawn.regions + 1, boxes: answer.boxes, boxesAt: asked });
});

function drawLines() {
  const shown = get('with-seen').checked ? features : [];
  picture.drawLines({ features: shown, regions, age: regionAge, selected, candidates, candidate });
}

/** @type {number|undefined} */
let rest;

/** The pose or the layer changed: draw it now, and all of it once the pointer rests. */
function changed({ keep = false } = {}) {
  if (!keep) drop();
  regionAge = 0.25;
  poseField.value = poses.text(pose);
  poseField.classList.remove('wrong');
  plan.set({ pose });
  ask({ full: false });
  clearTimeout(rest);
  rest = setTimeout(settle, dragging ? 160 : 60);
}

async function settle() {
  views.remember(pose);
  await ask({ full: true });
  askRegions();
  explain();
  mapGoesOn();
}

/** @param {number[]} next */
function go(next) {
  pose = next;
  changed();
}

// The layer.

/** Takes a new state of the session. @param {any} next @param {boolean} [first] */
async function take(next, first = false) {
  const older = first || state.version !== next.version;
  state = next;
  if (older) list.take(await send('features'));
  selected = new Set([...selected].filter(id => list.known(id)));
  list.select(selected);
  get('what').textContent = `${state.scene}  ·  ${state.sensor.name}  ·  ${state.layer}${state.named ? '' : ' (new)'}`;
  get('undo').disabled = !state.undo;
  get('redo').disabled = !state.redo;
  get('undo').title = state.undo ? `Ctrl+Z: ${state.undo}` : 'nothing to undo';
  get('redo').title = state.redo ? `Ctrl+Y: ${state.redo}` : 'nothing to redo';
  get('save').hidden = state.stored;
  get('saved').textContent = state.stored ? 'every step is stored' : state.unsaved ? `${state.unsaved} not saved` : 'saved';
  get('saved').classList.toggle('open', Boolean(state.unsaved));
  const offered = state.offered;
  get('offer').hidden = !offered;
  if (offered) {
    get('offer').firstElementChild.textContent = `An earlier session made ${offered.steps} steps that it did not save${
      offered.fits ? '.' : '; they may be for another version of the layer.'}`;
  }
}

/** Sends a step and shows what came of it. @param {string} name @param {object} [body] */
async function step(name, body = {}) {
  const next = await guarded(() => send(name, { version: state.version, ...body }));
  if (!next) return false;
  await take(next);
  say(next.said, true);
  changed({ keep: true });
  return true;
}

/** @param {object} change @param {string} label */
const change = (change, label) => step('change', { change, label });

async function makeFeature() {
  const chosen = pick?.candidates[candidate - 1];
  if (!chosen) return;
  const id = state.next_id;
  const feature = { ...panel.edited(chosen.feature), id };
  const kind = feature.name ?? feature.kind;
  const insert = { op: 'insert_feature', class: state.sensor.class, feature };
  const wider = { op: 'set_tolerance', class: state.sensor.class, tolerance: pick.tolerance };
  const both = pick.tolerance > state.tolerance ? { op: 'group', changes: [wider, insert] } : insert;
  if (await change(both, `make ${kind} ${id}`)) choose(new Set([id]));
}

/** @type {any} */
let opened = null;

async function setFeature() {
  if (!opened) return;
  const feature = panel.edited(opened);
  if (JSON.stringify(feature) === JSON.stringify(opened)) return;
  if (await change({ op: 'set_feature', class: state.sensor.class, feature }, `set ${feature.name ?? feature.kind} ${feature.id}`)) {
    choose(new Set([feature.id]));
  }
}

/** @param {Set<number>} ids */
async function dropFeatures(ids) {
  const all = [...ids].filter(id => list.known(id));
  if (!all.length) return;
  const deletions = all.map(id => ({ op: 'delete_feature', class: state.sensor.class, feature: id }));
  const label = all.length === 1 ? `drop ${all[0]}` : `drop ${all.length} features`;
  if (await change(deletions.length === 1 ? deletions[0] : { op: 'group', changes: deletions }, label)) choose(new Set());
}

// What is chosen.

/** @param {Set<number>} ids */
async function choose(ids) {
  drop(false);
  selected = ids;
  list.select(selected);
  opened = null;
  drawLines();
  if (!ids.size) return panel.empty();
  if (ids.size > 1) return showMany();
  const [id] = ids;
  const answer = await guarded(() => send('entry', { id }));
  if (!answer || !(selected.has(id) && selected.size === 1)) return;
  opened = answer.feature;
  const known = list.known(id);
  panel.show({
    title: `Feature ${id}: ${opened.name ?? opened.kind}`, about: known?.object ?? '', feature: opened, name: opened.name ?? '',
    buttons: [['Set', 'p-set', setFeature], ['Drop', 'p-drop', () => dropFeatures(new Set([id]))]], onDone: setFeature,
  });
  explain();
}

function showMany() {
  const seen = features.length ? new Set(features.filter(f => f.style !== 'hidden').map(f => f.feature)) : new Set();
  const others = new Set([...seen].filter(id => !selected.has(id)));
  get('panel').replaceChildren(
    panel.make('h2', {}, `${selected.size} features`),
    panel.make('p', { className: 'quiet' }, 'Drop them, or keep them and drop the others that are seen here.'),
    panel.make('div', { className: 'buttons' },
      panel.make('button', { id: 'p-drop', className: 'main', onclick: () => dropFeatures(selected) }, `Drop ${selected.size}`),
      panel.make('button', { id: 'p-keep', onclick: () => dropFeatures(others) }, `Keep, drop ${others.size} others`)));
}

/** Says of the chosen feature why parts of it are hidden here. */
async function explain() {
  if (selected.size !== 1 || !state.sensor.projects) return;
  const [id] = selected;
  const answer = await guarded(() => send('why', { pose, ids: [id] }));
  if (answer?.features.length && selected.has(id)) {
    const object = list.known(id)?.object;
    panel.about(`${object ? `${object}: ` : ''}${panel.reasons(answer.features[0])}`);
  }
}

/** Forgets the pick. */
function drop(redraw = true) {
  if (!pick) return;
  [pick, candidates, candidate] = [null, [], 0];
  if (redraw) {
    panel.empty();
    drawLines();
  }
}

/** @param {number[]} at The picture's position. */
async function click(at) {
  stage.focus();
  const near = get('with-seen').checked ? picture.nearest(features, at) : 0;
  if (near) return choose(new Set([near]));
  const pixel = frame && picture.pixel(frame, at, state.sensor.size);
  if (!pixel) return;
  const answer = await guarded(() => send('pick', { pose, pixel }));
  if (!answer) return;
  await choose(new Set());
  if (!answer.hit) return say('There is nothing at this pixel.');
  say('');
  pick = answer;
  candidates = picture.strokes(answer);
  offer(1);
}

/** @param {number} number */
function offer(number) {
  candidate = number;
  const { feature, pixels } = pick.candidates[number - 1];
  const hit = pick.hit;
  panel.show({
    title: `New: ${feature.name ?? feature.kind}  (${number} of ${pick.candidates.length})`,
    about: `${feature.object ?? 'world'}, ${hit.material}, ${hit.range.toFixed(3)} m away${pixels === null ? '' : `, ${pixels.toFixed(1)} px off`}`,
    feature, name: feature.name ?? '', onDone: makeFeature,
    buttons: [['Make it a feature', 'p-make', makeFeature], ['Next', 'p-next', () => offer((candidate % pick.candidates.length) + 1)]],
  });
  drawLines();
}

// The map.

/** @type {{spacing: number, floor: number, height: number|null, pixel_sigma: number|null, since: number, on: boolean}} */
const map = { spacing: 1, floor: 0, height: null, pixel_sigma: null, since: 0, on: false };
/** @type {Map<string, any>} */
let cells = new Map();
let working = false;

async function mapGoesOn() {
  if (working || !map.on) return;
  working = true;
  get('map-go').textContent = 'Stop';
  while (map.on && !dragging) {
    const { spacing, floor, height, pixel_sigma, since } = map;
    const asked = { version: state.version, spacing, floor, height, pixel_sigma, since, budget_ms: 25 };
    const answer = await guarded(() => send('worth', asked));
    if (!answer) {
      map.on = false;
      break;
    }
    if (since !== map.since) continue;
    map.since = answer.stamp;
    for (const place of answer.places) cells.set(`${place[0]},${place[1]}`, place);
    plan.set({ cells, spacing, coarse: answer.done === answer.of ? 1 : 4 * answer.done < answer.of ? 4 : 2 });
    drawn.worth = { ...answer, cells };
    get('map-said').textContent = `${answer.done} of ${answer.of} places, eight headings each, ${(floor + (height ?? state.sensor.mount_height)).toFixed(2)} m high`;
    if (answer.done === answer.of) break;
  }
  working = false;
  get('map-go').textContent = 'Start';
}

function startMap() {
  if (map.on && working) {
    map.on = false;
    return;
  }
  const number = (/** @type {string} */ id) => Number(get(id).value);
  const mounted = state.sensor.mount_height;
  const floor = number('m-floor');
  const height = mounted ? null : Math.max(0, Math.round((pose[2] - floor) * 1e3) / 1e3);
  const sigma = state.sensor.pixel_sigma > 0 ? null : number('m-pixel');
  if (sigma === 0) return say('The sensor states no pixel noise: give one standard deviation of an edge in the image, in pixels.');
  Object.assign(map, { spacing: number('m-spacing'), floor, height, pixel_sigma: sigma, since: 0, on: true });
  cells = new Map();
  plan.set({ cells, spacing: map.spacing });
  mapGoesOn();
}

async function drawPlan() {
  const answer = await guarded(() => send('plan', { height: pose[2] }));
  if (answer) plan.set({ pieces: answer.pieces, bounds: state.bounds });
}

// Pointer and keys.

/** @type {any} */
let press = null;

stage.addEventListener('pointerdown', (/** @type {PointerEvent} */ event) => {
  if (event.button > 2) return;
  stage.setPointerCapture(event.pointerId);
  press = {
    x: event.clientX, y: event.clientY, from: picture.place(event), pose, moved: false, many: event.shiftKey && event.button === 0,
    how: event.altKey || event.button === 1 ? 'orbit' : event.ctrlKey || event.button === 2 ? 'pan' : 'turn', away: distance(),
  };
});

stage.addEventListener('pointermove', (/** @type {PointerEvent} */ event) => {
  if (!press) return hover(event);
  const [dx, dy] = [event.clientX - press.x, event.clientY - press.y];
  if (!press.moved && Math.hypot(dx, dy) < 4) return;
  press.moved = true;
  if (press.many) {
    const box = stage.getBoundingClientRect();
    Object.assign(band.style, {
      left: `${Math.min(event.clientX, press.x) - box.left}px`, top: `${Math.min(event.clientY, press.y) - box.top}px`,
      width: `${Math.abs(dx)}px`, height: `${Math.abs(dy)}px`,
    });
    band.hidden = false;
    return;
  }
  dragging = true;
  const degrees = Math.min(0.25, view().across / stage.clientWidth);
  if (press.how === 'orbit') return go(poses.orbited(press.pose, press.away, dx * degrees, -dy * degrees));
  if (press.how === 'pan') {
    const metres = press.away * Math.tan(degrees * Math.PI / 180);
    return go(poses.panned(press.pose, dx * metres, dy * metres));
  }
  go(poses.turned(press.pose, dx * degrees, -dy * degrees));
});

const release = (/** @type {PointerEvent} */ event) => {
  if (!press) return;
  const { moved, many, from } = press;
  press = null;
  band.hidden = true;
  if (moved && many) choose(picture.within(features, from, picture.place(event)));
  else if (!moved && event.button === 0) click(picture.place(event));
  if (!dragging) return;
  dragging = false;
  clearTimeout(rest);
  rest = setTimeout(settle, 30);
};
stage.addEventListener('pointerup', release);
stage.addEventListener('contextmenu', (/** @type {Event} */ event) => event.preventDefault());
stage.addEventListener('mousedown', (/** @type {MouseEvent} */ event) => event.button === 1 && event.preventDefault());
stage.addEventListener('pointercancel', () => { press = null; dragging = false; band.hidden = true; });

stage.addEventListener('wheel', (/** @type {WheelEvent} */ event) => {
  event.preventDefault();
  go(poses.moved(pose, -Math.sign(event.deltaY) * speed(), 0, 0));
}, { passive: false });

/** Metres to what the middle of the picture shows, around which the view orbits; a few steps where it shows nothing. */
function distance() {
  const { range, size } = frame ?? {};
  const middle = range?.[Math.floor(size[1] / 2) * size[0] + Math.floor(size[0] / 2)];
  return Number.isFinite(middle) && middle > 0 ? middle : 20 * speed();
}

/** Metres of a step: a fiftieth of what the scene spans, 5 cm to 1 m. */
function speed() {
  const [a, b] = state.bounds ?? [[0, 0], [5, 5]];
  return Math.min(1, Math.max(0.05, Math.round(Math.max(b[0] - a[0], b[1] - a[1])) / 50));
}

/** @type {Record<string, () => number[]>} */
const KEYS = {
  w: () => poses.moved(pose, speed(), 0, 0), s: () => poses.moved(pose, -speed(), 0, 0),
  a: () => poses.moved(pose, 0, speed(), 0), d: () => poses.moved(pose, 0, -speed(), 0),
  q: () => poses.moved(pose, 0, 0, -speed() / 2), e: () => poses.moved(pose, 0, 0, speed() / 2),
  '[': () => poses.turned(pose, 0, -2), ']': () => poses.turned(pose, 0, 2),
  ArrowLeft: () => poses.turned(pose, 3, 0), ArrowRight: () => poses.turned(pose, -3, 0),
};

stage.addEventListener('keydown', (/** @type {KeyboardEvent} */ event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (KEYS[key]) go(KEYS[key]());
  else if (key === 'Tab' && pick) offer(((candidate - 1 + (event.shiftKey ? -1 : 1) + pick.candidates.length) % pick.candidates.length) + 1);
  else if (key === 'Enter' && pick) makeFeature();
  else if (key === 'Enter' || key === ' ') click(middle());
  else if (key === 'Delete' || key === 'Backspace') dropFeatures(selected);
  else if (key === 'Escape') choose(new Set());
  else return;
  event.preventDefault();
});

/** The middle of the picture, for those without a pointer. */
function middle() {
  const image = get('image');
  return [image.width / 2, image.height / 2];
}

get('list').addEventListener('keydown', (/** @type {KeyboardEvent} */ event) => {
  if (event.key === 'Delete') dropFeatures(selected);
});

document.addEventListener('keydown', event => {
  if (!(event.ctrlKey || event.metaKey)) return;
  const key = event.key.toLowerCase();
  const inField = event.target instanceof HTMLInputElement && event.target.type !== 'checkbox' && event.target.type !== 'range';
  if (key === 's') save();
  else if (key === 'z' && !inField) step(event.shiftKey ? 'redo' : 'undo');
  else if (key === 'y' && !inField) step('redo');
  else return;
  event.preventDefault();
});

/** @param {MouseEvent} event */
function hover(event) {
  const at = frame && frame.stride === 1 && picture.pixel(frame, picture.place(event), state.sensor.size);
  if (!at || !frame.range || !frame.object_id) return;
  const i = at[1] * frame.size[0] + at[0];
  const range = frame.range[i];
  const angle = Math.acos(Math.min(1, frame.cos_incidence?.[i] ?? NaN)) * 180 / Math.PI;
  get('hover').textContent = Number.isFinite(range)
    ? `${at[0]},${at[1]}  ${list.objectOf(frame.object_id[i])}  polygon ${frame.polygon_id[i]}  ${range.toFixed(3)} m  ${angle.toFixed(1)}° off the normal`
    : `${at[0]},${at[1]}  nothing`;
}

/** The angle that the picture spans, degrees. */
function view() {
  return { across: state.sensor.field_of_view ?? 60 };
}

// Fields and buttons.

poseField.addEventListener('input', () => {
  const numbers = poses.parse(poseField.value);
  poseField.classList.toggle('wrong', !numbers);
});
get('where').addEventListener('submit', async (/** @type {Event} */ event) => {
  event.preventDefault();
  const numbers = poses.parse(poseField.value);
  if (!numbers) return say('The pose is not x,y,z,roll,pitch,yaw (metres, degrees) or x,y,z,qx,qy,qz,qw.');
  const answer = numbers.length === 7 ? await guarded(() => send('frame', { pose: numbers, outputs: ['polygon_id'] })) : { pose: numbers };
  if (answer) go(answer.pose);
});

/** The command that predicts this view. */
function command() {
  const pictureOf = output === 'range' ? '' : ` --png-of ${output}`;
  let line = `${state.command} --pose ${poses.text(pose)} --png view.png${pictureOf}`;
  if (state.named && !state.stored) line += ` --layer ${state.layer_word}`;
  if (state.features && (state.named || state.stored) && get('with-regions').checked) {
    const [p, h, c] = ['s-position', 's-heading', 's-confidence'].map(id => get(id).value);
    line += ` --pose-cov ${p},${p},0,0,0,${h} --confidence ${c}`;
  }
  return line;
}
get('copy').addEventListener('click', async () => {
  const line = command();
  try {
    await navigator.clipboard.writeText(line);
    say(`Copied: ${line}`, true);
  } catch {
    say(line, true);
  }
});

async function save() {
  if (state.stored) return;
  if (await step('save')) return;
  const suggestion = String(state.layer).split(/[\\/]/).pop()?.replace(/(-\d+)?(\.[^.]*\.layer\.json|\.json)$/, '-edited$2');
  const name = panel.make('input', { id: 's-name', value: suggestion });
  const form = panel.make('form', {}, panel.make('h2', {}, 'Save under another name'), name,
    panel.make('div', { className: 'buttons' }, panel.make('button', { className: 'main', id: 's-save' }, 'Save')));
  form.addEventListener('submit', (/** @type {Event} */ event) => {
    event.preventDefault();
    step('save', { name: /** @type {HTMLInputElement} */ (name).value }).then(done => done && panel.empty());
  });
  get('panel').replaceChildren(form);
}

function wire() {
  get('outputs').replaceChildren(...state.outputs.map((/** @type {any} */ o) =>
    panel.make('button', {
      className: o.name === output ? 'on' : '', onclick: (/** @type {any} */ event) => {
        output = o.name;
        for (const b of get('outputs').children) b.classList.toggle('on', b === event.target);
        changed({ keep: true });
      },
    }, o.name.replace('cos_incidence', 'incidence').replace('_id', '').replace('_', ' '))));
  for (const id of ['with-seen', 'with-regions', 'with-hidden']) get(id).addEventListener('change', () => changed({ keep: true }));
  const units = { 's-position': ['cm', 100], 's-heading': ['°', 1], 's-confidence': ['%', 100] };
  for (const [id, [unit, times]] of Object.entries(units)) {
    const told = () => { get(id).nextElementSibling.textContent = `${(get(id).value * Number(times)).toFixed(1)} ${unit}`; };
    get(id).addEventListener('input', () => { told(); askRegions(); });
    told();
  }
  get('undo').onclick = () => step('undo');
  get('redo').onclick = () => step('redo');
  get('save').onclick = save;
  get('take').onclick = () => step('restore', { keep: true });
  get('drop').onclick = () => step('restore', { keep: false });
  get('said').lastElementChild.onclick = () => say('');
  get('map-go').onclick = startMap;
  for (const button of get('map-of').children) {
    button.onclick = () => {
      for (const b of get('map-of').children) b.classList.toggle('on', b === button);
      plan.set({ of: button.dataset.of === 'position' ? 6 : 7 });
    };
  }
  get('make-view').onclick = () => step('generate', { pose });
  get('make-model').onclick = () => step('generate', { pose: null });
  views.start(state.scene, () => pose, go);
  get('m-pixel-box').hidden = state.sensor.pixel_sigma > 0;
  new ResizeObserver(() => { picture.fit(); drawLines(); }).observe(stage);
}

list.start((id, more) => {
  const next = more ? new Set(selected) : new Set();
  if (more && selected.has(id)) next.delete(id);
  else next.add(id);
  choose(next);
});
plan.start((x, y) => go(poses.rounded([x, y, ...pose.slice(2)])));
panel.empty();
await guarded(async () => {
  state = await send('state');
  pose = state.pose;
  pose = views.asked() ?? pose;
  if (state.measured) measured = await send('measured');
  get('measured').hidden = !measured;
  wire();
  // The picture comes first, then the lists.
  const shown = ask({ full: false });
  plan.set({ bounds: state.bounds, fov: view().across, pose });
  await shown;
  await take(state, true);
  for (const notice of state.notices) say(notice);
  changed();
  drawPlan();
  stage.focus();
});
