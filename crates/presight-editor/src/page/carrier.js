// The one function by which the page talks to a session: message in, message out. Here by HTTP.

const token = location.hash.slice(1).split('@')[0];

/** The pose in the page's address, behind its token; empty without one. */
export const poseInAddress = () => location.hash.split('@')[1] ?? '';

/** The address of this page with a pose. @param {string} pose */
export const addressOf = pose => `#${token}@${pose}`;

/** What the server refuses, with its remedy in the text. */
export class Refused extends Error {}

/** The page knows an older version of the layer. */
export class Behind extends Error {
  /** @param {any} state */
  constructor(state) {
    super(state.said ?? 'The layer was changed elsewhere; this page is up to date again.');
    this.state = state;
  }
}

/**
 * Sends a message. Binary answers come as their JSON, with the arrays they list.
 * @param {string} name
 * @param {object} [body]
 * @returns {Promise<any>}
 */
export async function send(name, body = {}) {
  let answer;
  try {
    answer = await fetch('/' + name, {
      method: 'POST',
      headers: { 'x-presight-token': token },
      body: JSON.stringify(body),
    });
  } catch {
    throw new Refused('The editor does not answer: presight edit has ended. Start it again; steps that were not saved are offered then.');
  }
  if (answer.ok) {
    const binary = answer.headers.get('content-type') === 'application/octet-stream';
    return binary ? unpacked(await answer.arrayBuffer()) : answer.json();
  }
  if (answer.status === 409) throw new Behind(await answer.json());
  if (answer.status === 403) throw new Refused('The address lacks its token: open the one that presight edit prints.');
  if (answer.status === 422) throw new Refused((await answer.json()).error);
  throw new Refused(`The editor refuses ${name} (${answer.status}).`);
}

/** @param {ArrayBuffer} buffer */
function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = Math.ceil((4 + length) / 4) * 4;
  for (const { name, kind, numbers } of json.arrays) {
    json[name] = kind === 'u32' ? new Uint32Array(buffer, at, numbers) : new Float32Array(buffer, at, numbers);
    at += 4 * numbers;
  }
  return json;
}

/**
 * Keeps one message under way: of those that come meanwhile, only the newest is sent.
 * @template T
 * @param {(wish: T) => Promise<void>} work
 */
export function newest(work) {
  /** @type {{wish: T}|null} */
  let next = null;
  let busy = false;
  return async (/** @type {T} */ wish) => {
    next = { wish };
    if (busy) return;
    busy = true;
    try {
      while (next) {
        const { wish } = next;
        next = null;
        await work(wish);
      }
    } finally {
      busy = false;
    }
  };
}
