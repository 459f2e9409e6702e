// The list of features: only the rows in view exist.

const HEIGHT = 22;

/** @param {string} id */
const get = id => /** @type {any} */ (document.getElementById(id));
const list = get('list'), inner = list.firstElementChild, count = get('count');
const [text, kind, seenOnly, length] = ['f-text', 'f-kind', 'f-seen', 'f-length'].map(get);

/** @type {any} */
let all = { ids: [], kinds: [], name: [], object: [], length: [], names: [], objects: [], lost: [] };
/** @type {Map<number, number>} */
let index = new Map();
let seen = new Set();
let lost = new Set();
let selected = new Set();
/** Numbers of the rows that pass the filters. @type {number[]} */
let rows = [];
/** Small letters of each name and object of the tables. @type {string[][]} */
let small = [[], []];
/** @type {(id: number, more: boolean) => void} */
let choose = () => {};

/** @param {(id: number, more: boolean) => void} onChoose */
export function start(onChoose) {
  choose = onChoose;
  for (const input of [text, kind, seenOnly, length]) input.addEventListener('input', filter);
  list.addEventListener('scroll', draw);
  list.addEventListener('click', (/** @type {MouseEvent} */ event) => {
    const row = /** @type {HTMLElement} */ (event.target).closest('.row');
    if (row) choose(Number(/** @type {HTMLElement} */ (row).dataset.id), event.shiftKey || event.ctrlKey);
  });
  list.addEventListener('keydown', (/** @type {KeyboardEvent} */ event) => {
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!by || !rows.length) return;
    const at = rows.findIndex(row => selected.has(all.ids[row]));
    const next = Math.min(rows.length - 1, Math.max(0, at < 0 ? 0 : at + by));
    choose(all.ids[rows[next]], false);
    list.scrollTop = Math.min(Math.max(list.scrollTop, (next + 1) * HEIGHT - list.clientHeight), next * HEIGHT);
    event.preventDefault();
  });
}

/** Takes the columns of the layer. @param {any} columns */
export function take(columns) {
  all = columns;
  index = new Map(all.ids.map((/** @type {number} */ id, /** @type {number} */ i) => [id, i]));
  lost = new Set(all.lost);
  small = [all.names, all.objects].map(words => words.map((/** @type {string} */ w) => w.toLowerCase()));
  const kinds = [...new Set(all.kinds)].sort();
  const was = kind.value;
  kind.replaceChildren(new Option('any kind', ''), ...kinds.map(k => new Option(String(k))));
  kind.value = kinds.includes(was) ? was : '';
  filter();
}

/** @param {Iterable<number>} ids */
export function show(ids) {
  seen = new Set(ids);
  if (seenOnly.checked) filter();
  else draw();
}

/** @param {Set<number>} ids */
export function select(ids) {
  selected = ids;
  draw();
}

/** What the list knows of a feature; null if it is not there. @param {number} id */
export function known(id) {
  const i = index.get(id);
  if (i === undefined) return null;
  const [name, object] = [all.names[all.name[i]], all.objects[all.object[i]]];
  return { id, kind: all.kinds[i], name, object, length: all.length[i], seen: seen.has(id), lost: lost.has(id) };
}

/** The name of an object by its image's id. @param {number} id */
export const objectOf = id => all.all_objects?.[id - 1] ?? '';

function filter() {
  const words = text.value.toLowerCase();
  const least = Number(length.value) || 0;
  const fits = small.map(table => table.map(word => word.includes(words)));
  rows = [];
  for (let i = 0; i < all.ids.length; i++) {
    if (kind.value && all.kinds[i] !== kind.value) continue;
    if (all.length[i] < least) continue;
    if (seenOnly.checked && !seen.has(all.ids[i])) continue;
    if (words && !fits[0][all.name[i]] && !fits[1][all.object[i]] && String(all.ids[i]) !== words) continue;
    rows.push(i);
  }
  inner.style.height = `${rows.length * HEIGHT}px`;
  draw();
}

function draw() {
  count.textContent = `${rows.length} of ${all.ids.length}, ${seen.size} seen here`;
  const first = Math.max(0, Math.floor(list.scrollTop / HEIGHT) - 2);
  const last = Math.min(rows.length, first + Math.ceil(list.clientHeight / HEIGHT) + 4);
  inner.replaceChildren(...rows.slice(first, last).map((i, k) => {
    const id = all.ids[i];
    const row = document.createElement('div');
    row.className = `row${seen.has(id) ? ' seen' : ''}${selected.has(id) ? ' on' : ''}${lost.has(id) ? ' lost' : ''}`;
    row.style.top = `${(first + k) * HEIGHT}px`;
    row.dataset.id = String(id);
    const size = all.length[i] ? `${all.length[i].toFixed(2)} m` : '';
    const words = { id, kind: all.kinds[i], name: all.names[all.name[i]] || all.objects[all.object[i]], length: size };
    for (const [name, word] of Object.entries(words)) {
      const cell = document.createElement('span');
      cell.className = name;
      cell.textContent = String(word);
      row.append(cell);
    }
    row.title = all.objects[all.object[i]];
    return row;
  }));
}
