// The side panel: the candidate or the feature that is chosen, with its name and standard deviations.

const panel = /** @type {HTMLElement} */ (document.getElementById('panel'));

/** @param {string} tag @param {any} [fields] @param {(Node|string)[]} inner */
export function make(tag, fields = {}, ...inner) {
  const element = Object.assign(document.createElement(tag), fields);
  element.append(...inner);
  return element;
}

/** In place of a choice. */
export function empty() {
  panel.replaceChildren(
    make('h2', {}, 'Nothing chosen'),
    make('p', { className: 'quiet' }, 'Click an edge, a corner or a surface to make it a landmark. Click a pink line to change or drop one.'),
  );
}

/** @param {string} reason */
const plain = reason => reason.replaceAll('_', ' ');

/** Why parts of a feature are hidden, in words. @param {any} why */
export function reasons(why) {
  if (!why) return '';
  const share = `${Math.round(100 * why.visible)} % visible`;
  const hidden = why.hidden.map((/** @type {any} */ h) =>
    `${Math.round(100 * h.share)} % ${plain(h.reason)}${h.by ? ` by ${h.by}` : ''}`);
  return [share, ...hidden].join(', ');
}

/**
 * Shows a candidate or a feature.
 * @param {{title: string, about: string, feature: any, name: string, buttons: [string, string, () => void][], onDone: () => void}} what
 */
export function show({ title, about, feature, name, buttons, onDone }) {
  const across = feature.kind === 'segment' || feature.kind === 'patch';
  const [s, t] = sigmas(feature);
  const field = (/** @type {string} */ id, /** @type {any} */ value, /** @type {string} */ hint) =>
    make('input', { id, value, title: hint, autocomplete: 'off', spellcheck: false });
  const both = across && s !== t;
  const one = field('p-sigma', both ? '' : short(s), 'One standard deviation of the position, metres');
  const along = field('p-along', both ? short(s) : '', feature.kind === 'segment' ? 'Along the edge, metres' : 'In the plane, metres');
  const side = field('p-across', both ? short(t) : '', feature.kind === 'segment' ? 'Across the edge, metres' : 'Off the plane, metres');
  for (const [input, hint] of [[one, 'all axes'], [along, 'along'], [side, 'across']]) {
    Object.assign(input, { type: 'number', min: '0', step: 'any', placeholder: hint });
  }
  one.addEventListener('input', () => { along.value = side.value = ''; });
  for (const input of [along, side]) input.addEventListener('input', () => { one.value = ''; });
  const form = make('form', {},
    make('h2', {}, title),
    make('p', { className: 'quiet', id: 'p-about' }, about),
    make('div', { className: 'grid' },
      make('label', { htmlFor: 'p-name' }, 'name'), field('p-name', name, 'For people'),
      make('label', { htmlFor: 'p-sigma' }, 'sigma, m'), make('div', { className: 'sigmas' }, one, ...(across ? [along, side] : []))),
    make('div', { className: 'buttons' }, ...buttons.map(([words, id, act], i) =>
      make('button', { type: 'button', id, className: i ? '' : 'main', onclick: act }, words))));
  form.addEventListener('submit', (/** @type {Event} */ event) => { event.preventDefault(); onDone(); });
  form.addEventListener('keydown', (/** @type {KeyboardEvent} */ event) => { if (event.key === 'Enter') { event.preventDefault(); onDone(); } });
  panel.replaceChildren(form);
  panel.scrollIntoView({ block: 'nearest' });
}

/** @param {string} words */
export function about(words) {
  const place = document.getElementById('p-about');
  if (place) place.textContent = words;
}

/** @param {number} x */
const short = x => String(Number(x.toPrecision(6)));

/** The feature as the panel's fields have it. @param {any} feature */
export function edited(feature) {
  const value = (/** @type {string} */ id) => /** @type {HTMLInputElement|null} */ (document.getElementById(id))?.value.trim() ?? '';
  const changed = { ...feature };
  const name = value('p-name');
  if (name) changed.name = name;
  else delete changed.name;
  const [one, along, across] = [value('p-sigma'), value('p-along'), value('p-across')];
  const [s, t] = sigmas(feature);
  if (one !== '' && (short(s) !== one || s !== t)) return without(changed, { sigma: Number(one) });
  if (one === '' && (along !== '' || across !== '')) {
    const [a, b] = [Number(along || across), Number(across || along)];
    if (short(s) !== String(a) || short(t) !== String(b)) return without(changed, { covariance: covariance(feature, a, b) });
  }
  return changed;
}

/** @param {any} feature @param {object} instead */
function without(feature, instead) {
  const { sigma, covariance, covariances, cross_covariance, ...rest } = feature;
  return { ...rest, ...instead };
}

/** The direction of an edge, or the normal of a plane. @param {any} feature */
function axis(feature) {
  const [a, b, c] = feature.points;
  const sub = (/** @type {number[]} */ p, /** @type {number[]} */ q) => p.map((x, i) => x - q[i]);
  const unit = (/** @type {number[]} */ v) => v.map(x => x / Math.hypot(...v));
  if (feature.kind === 'segment') return unit(sub(b, a));
  const [u, v] = [sub(b, a), sub(c, a)];
  return unit([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]);
}

/** Standard deviations along and across. @param {any} feature */
export function sigmas(feature) {
  const c = feature.covariance ?? feature.covariances?.[0];
  if (!c) {
    const s = feature.sigma ?? 0;
    return Array.isArray(s) ? [s[0], s[1]] : [s, s];
  }
  if (feature.kind !== 'segment' && feature.kind !== 'patch') return [Math.sqrt(c[0]), Math.sqrt(c[0])];
  const n = axis(feature);
  const on = n.reduce((sum, ni, i) => sum + ni * (c[3 * i] * n[0] + c[3 * i + 1] * n[1] + c[3 * i + 2] * n[2]), 0);
  const off = Math.max(0, (c[0] + c[4] + c[8] - on) / 2);
  const [s, t] = [Math.sqrt(Math.max(0, on)), Math.sqrt(off)].map(x => Number(x.toPrecision(9)));
  return feature.kind === 'segment' ? [s, t] : [t, s];
}

/** Along and across the edge, or in and off the plane. @param {any} feature @param {number} along @param {number} across */
export function covariance(feature, along, across) {
  const n = axis(feature);
  const [on, off] = feature.kind === 'segment' ? [along ** 2, across ** 2] : [across ** 2, along ** 2];
  return [0, 1, 2].flatMap(i => [0, 1, 2].map(j => off * (i === j ? 1 : 0) + (on - off) * n[i] * n[j]));
}
