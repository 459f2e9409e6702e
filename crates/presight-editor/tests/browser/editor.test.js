// The page in a browser: what a person does with it, and what comes of it on the disk.
// PRESIGHT names the command, CHROMIUM the browser, PRESIGHT_EDITOR_PICTURE a file for a picture of the page,
// PRESIGHT_EDITOR_PAGE a folder with the page's files, in place of those that the command holds.

import assert from 'node:assert/strict';
import { execFileSync, spawn } from 'node:child_process';
import { createHash } from 'node:crypto';
import { existsSync, mkdtempSync, readFileSync, rmSync, symlinkSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { after, afterEach, before, beforeEach, test } from 'node:test';
import { chromium } from 'playwright-core';

const command = process.env.PRESIGHT ?? resolve('../../../../target/debug/presight');
const room = resolve('../../../../scenes/room.glb');
const POSE = '0.3,0.35,1.65,0,12,38';
/** On the front edge of the table. */
const EDGE = [300, 330];

let browser;
/** A generated layer of the room. */
let many;
/** A folder for each test. */
let folder = mkdtempSync(join(tmpdir(), 'presight-editor-'));
const running = new Set();

const run = (...args) => execFileSync(command, args, { cwd: folder, encoding: 'utf8', maxBuffer: 1 << 28 });

/** Starts the editor; answers its address when it listens. */
async function start(...args) {
  const sensor = args.includes('--sensor') ? [] : ['--sensor', 'video-camera'];
  const all = ['edit', 'room.glb', ...sensor, '--pose', POSE, '--no-open', '--backend', 'cpu', ...args];
  const child = spawn(command, all, { cwd: folder, stdio: ['ignore', 'pipe', 'inherit'] });
  running.add(child);
  const address = await new Promise((done, fail) => {
    let text = '';
    child.stdout.on('data', data => {
      text += data;
      if (text.includes('\n')) done(text.trim());
    });
    child.on('exit', code => fail(new Error(`presight edit ended with ${code}`)));
  });
  const stop = signal => new Promise(done => {
    running.delete(child);
    if (child.exitCode !== null || child.signalCode) return done();
    child.removeAllListeners('exit');
    child.on('exit', done);
    child.kill(signal);
  });
  return { address, stop };
}

/** The page's files from a folder, to work on them without a build. */
const local = route => {
  const name = new URL(route.request().url()).pathname.slice(1) || 'index.html';
  return route.request().method() === 'GET' ? route.fulfill({ path: join(process.env.PRESIGHT_EDITOR_PAGE, name) }) : route.continue();
};

/** Opens the page and waits until all of it is drawn. */
async function open(address, context = browser) {
  const page = await context.newPage({ viewport: { width: 1400, height: 860 } });
  page.faults = [];
  // Tests of other commands share the machine: slowness is not a fault here, figures.js measures it.
  page.setDefaultTimeout(150_000);
  if (process.env.PRESIGHT_EDITOR_PAGE) await page.route(/\/([a-z]+\.(js|css|svg))?(#.*)?$/, local);
  page.on('pageerror', e => page.faults.push(e.message));
  page.on('console', message => message.type() === 'error' && page.faults.push(message.text()));
  await page.goto(address);
  await full(page);
  return page;
}

/** Waits for a complete frame that is newer than what was drawn. */
async function full(page, since = 0) {
  await page.waitForFunction(s => window.presight.full > s && window.presight.full === window.presight.seq, since);
}

/** Clicks a pixel of the sensor's image. */
async function clickPixel(page, [u, v]) {
  const box = await page.locator('#image').boundingBox();
  await page.mouse.click(box.x + ((u + 0.5) * box.width) / 512, box.y + ((v + 0.5) * box.height) / 512);
}

async function saved(page) {
  await page.locator('#saved', { hasText: /^saved$/ }).waitFor();
}

/** The entry that `features pick` proposes first, with a standard deviation in place of its own. */
function proposed(sigma) {
  const text = run('features', 'pick', room, '--sensor', 'video-camera', '--pose', POSE, '--pixel', EDGE.join());
  const entry = JSON.parse(text.split('\n').find(line => line.startsWith('{"id"')));
  const s = sigma * sigma;
  return { ...entry, id: 1, covariance: [s, 0, 0, 0, s, 0, 0, 0, s] };
}

/** The camera on a mast of 1.2 m, as camera.toml. */
function mounted() {
  const toml = run('sensors', 'video-camera').replace('[noise]', '[mount]\nxyz = [0, 0, 1.2]\n\n[noise]');
  writeFileSync(join(folder, 'camera.toml'), toml);
}

const features = name => JSON.parse(readFileSync(join(folder, name), 'utf8')).features;

/** How many pixels of the page's image differ from those of a picture, which has a margin of 20 pixels and a title above. */
async function differing(page, picture) {
  const canvas = await page.evaluate(() => document.getElementById('image').toDataURL());
  const blank = await browser.newPage();
  const found = await blank.evaluate(async ([canvas, picture]) => {
    const read = async source => {
      const image = new Image();
      image.src = source;
      await image.decode();
      const context = new OffscreenCanvas(image.width, image.height).getContext('2d');
      context.drawImage(image, 0, 0);
      const { data } = context.getImageData(0, 0, image.width, image.height);
      return { width: image.width, height: image.height, data: new Uint32Array(data.buffer) };
    };
    const [a, b] = [await read(canvas), await read(picture)];
    const { left, top } = { left: 20, top: 20 + 26 };
    let differ = 0;
    for (let y = 0; y < a.height; y++) {
      for (let x = 0; x < a.width; x++) {
        if (a.data[y * a.width + x] !== b.data[(y + top) * b.width + x + left]) differ++;
      }
    }
    return differ / (a.width * a.height);
  }, [canvas, `data:image/png;base64,${readFileSync(join(folder, picture)).toString('base64')}`]);
  await blank.close();
  return found;
}

before(async () => {
  run('features', room, '--class', 'video', '--out', 'many.layer.json');
  many = readFileSync(join(folder, 'many.layer.json'));
  rmSync(folder, { recursive: true });
  browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: ['--no-sandbox', '--disable-gpu', '--force-color-profile=srgb'],
  });
});

beforeEach(() => {
  folder = mkdtempSync(join(tmpdir(), 'presight-editor-'));
  symlinkSync(room, join(folder, 'room.glb'));
  writeFileSync(join(folder, 'many.layer.json'), many);
});

afterEach(() => {
  for (const child of running) child.kill('SIGKILL');
  running.clear();
  rmSync(folder, { recursive: true, force: true });
});

after(() => browser?.close());

test('a click on an edge makes the feature that pick proposes', async () => {
  const { address, stop } = await start();
  const page = await open(address);
  await clickPixel(page, EDGE);
  await page.locator('#p-make').waitFor();
  await page.fill('#p-sigma', '0.002');
  await page.click('#p-make');
  await page.locator('#p-drop').waitFor();
  await page.click('#save');
  await saved(page);
  assert.deepEqual(features('room.video.layer.json'), [proposed(0.002)]);
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('the same by keyboard alone', async () => {
  const { address, stop } = await start();
  const page = await open(address);
  // The middle of the picture becomes the pixel: a turned pose, given as text.
  await page.locator('#stage').focus();
  await page.keyboard.press('Enter');
  await page.locator('#p-make').waitFor();
  const first = await page.locator('#panel h2').textContent();
  await page.keyboard.press('Tab');
  assert.notEqual(await page.locator('#panel h2').textContent(), first);
  await page.keyboard.press('Shift+Tab');
  assert.equal(await page.locator('#panel h2').textContent(), first);
  await page.keyboard.press('Enter');
  await page.locator('#p-drop').waitFor();
  await page.keyboard.press('Control+s');
  await saved(page);
  const text = run('features', 'pick', room, '--sensor', 'video-camera', '--pose', POSE, '--pixel', '256,256');
  const entries = text.split('\n').filter(line => line.startsWith('{"id"')).map(line => ({ ...JSON.parse(line), id: 1 }));
  const made = features('room.video.layer.json');
  assert.equal(made.length, 1);
  const planes = ['vertical', 'horizontal'].includes(made[0].name);
  assert.ok(planes || entries.some(entry => JSON.stringify(entry) === JSON.stringify(made[0])), JSON.stringify(made));
  await page.keyboard.press('Delete');
  await page.locator('#saved.open').waitFor();
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('a rubber band drops many, and undo to the start leaves the file as it was', async () => {
  const { address, stop } = await start('--layer', 'many.layer.json');
  const page = await open(address);
  const box = await page.locator('#image').boundingBox();
  await page.keyboard.down('Shift');
  await page.mouse.move(box.x + 4, box.y + 4);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width * 0.6, box.y + box.height * 0.9, { steps: 4 });
  await page.mouse.up();
  await page.keyboard.up('Shift');
  await page.locator('#p-keep').waitFor();
  const chosen = Number((await page.locator('#panel h2').textContent()).split(' ')[0]);
  assert.ok(chosen > 10, `${chosen} chosen`);
  await page.click('#p-drop');
  await page.locator('#saved', { hasText: `${chosen} not saved` }).waitFor();
  await page.keyboard.press('Control+z');
  await saved(page);
  await page.click('#save');
  await page.locator('#said', { hasText: 'nothing to save' }).waitFor();
  assert.deepEqual(readFileSync(join(folder, 'many.layer.json')), many);
  assert.ok(!existsSync(join(folder, 'many.layer.json.edits')));
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('the last frame of a drag is the prediction at its pose, and the canvas is its picture', async () => {
  const { address, stop } = await start('--layer', 'many.layer.json');
  const page = await open(address);
  const box = await page.locator('#image').boundingBox();
  const since = await page.evaluate(() => window.presight.seq);
  await page.mouse.move(box.x + 200, box.y + 200);
  await page.mouse.down();
  for (let i = 1; i <= 12; i++) await page.mouse.move(box.x + 200 + 9 * i, box.y + 200 - 3 * i);
  await page.mouse.up();
  await page.waitForFunction(since => {
    const { full, seq, pose, boxesAt } = window.presight;
    return seq > since && full === seq && pose === document.getElementById('pose').value && boxesAt === pose;
  }, since);
  const told = await page.evaluate(async () => {
    const frame = window.presight.frame();
    const field = document.getElementById('pose').value;
    const range = Array.from(new Uint8Array(await crypto.subtle.digest('SHA-256', frame.range.slice())));
    return { pose: window.presight.pose, field, range, count: frame.range.length, seen: frame.seen, boxes: window.presight.boxes };
  });
  assert.equal(told.pose, told.field);
  assert.notEqual(told.pose, POSE);
  const at = ['predict', room, '--sensor', 'video-camera', '--pose', told.pose, '--backend', 'cpu'];
  run(...at, '--outputs', 'range', '--npy', 'range.npy', '--png', 'view.png');
  run(...at, '--layer', 'many.layer.json', '--pose-cov', '0.05,0.05,0,0,0,2', '--features', 'seen.json');
  const npy = readFileSync(join(folder, 'range.npy'));
  const range = createHash('sha256').update(npy.subarray(npy.length - 4 * told.count)).digest();
  assert.deepEqual(Buffer.from(told.range), range);
  const file = JSON.parse(readFileSync(join(folder, 'seen.json'), 'utf8'));
  const seen = file.features.filter(f => f.visible?.length);
  assert.deepEqual(told.seen, seen.map(f => f.id));
  assert.deepEqual(told.boxes, seen.map(f => [f.id, f.roi]));

  assert.equal(await differing(page, 'view.png'), 0);
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('two tabs cannot disagree, and a reload in mid-edit loses nothing', async () => {
  const { address, stop } = await start('--layer', 'many.layer.json');
  const [one, two] = [await open(address), await open(address)];
  const drop = async (page, row) => {
    await page.locator('#list .row').nth(row).click();
    await page.click('#p-drop');
  };
  await drop(one, 0);
  await one.locator('#saved', { hasText: '1 not saved' }).waitFor();
  // The second tab is behind: its step is refused, and it shows the first one's.
  await drop(two, 3);
  await two.locator('#saved', { hasText: '1 not saved' }).waitFor();
  await two.locator('#said', { hasText: 'up to date again' }).waitFor();
  await drop(two, 3);
  await two.locator('#saved', { hasText: '2 not saved' }).waitFor();
  await one.reload();
  await full(one);
  await one.locator('#saved', { hasText: '2 not saved' }).waitFor();
  await one.keyboard.press('Control+z');
  await one.locator('#saved', { hasText: '1 not saved' }).waitFor();
  assert.deepEqual([...one.faults, ...two.faults].filter(f => !f.includes('409')), []);
  await one.close();
  await two.close();
  await stop();
});

test('a page of another origin learns and changes nothing', async () => {
  const { address, stop } = await start('--layer', 'many.layer.json');
  const [origin, token] = [new URL(address).origin, new URL(address).hash.slice(1)];
  const evil = createServer((_, answer) => answer.end('<!doctype html><title>evil</title>')).listen(0, '127.0.0.1');
  await new Promise(done => evil.on('listening', done));
  const page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${evil.address().port}/`);
  const tried = await page.evaluate(async ({ origin, token }) => {
    const attempt = async (path, options) => {
      try {
        const answer = await fetch(origin + path, options);
        return `${answer.type} ${answer.status} ${(await answer.text()).length}`;
      } catch (e) {
        return 'failed';
      }
    };
    const body = JSON.stringify({ version: 1 });
    const frame = document.createElement('iframe');
    frame.src = `${origin}/#${token}`;
    document.body.append(frame);
    await new Promise(done => { frame.onload = done; setTimeout(done, 1000); });
    let framed = 'closed';
    try {
      if (frame.contentDocument?.getElementById('stage')) framed = 'open';
    } catch { /* another origin */ }
    return {
      plain: await attempt('/state', { method: 'POST', body }),
      simple: await attempt('/state', { method: 'POST', mode: 'no-cors', body }),
      // Even with a token that leaked.
      leaked: await attempt('/undo', { method: 'POST', body, headers: { 'x-presight-token': token } }),
      file: await attempt('/', { mode: 'no-cors' }),
      framed,
    };
  }, { origin, token });
  assert.deepEqual(tried, { plain: 'failed', simple: 'failed', leaked: 'failed', file: 'failed', framed: 'closed' });
  await page.close();
  evil.close();
  await stop();
});

test('killed at any moment, the file is whole and no acknowledged step is lost', async () => {
  const rounds = Number(process.env.PRESIGHT_EDITOR_KILLS ?? 12);
  const post = async (address, name, body) => {
    const { origin, hash } = new URL(address);
    const answer = await fetch(`${origin}/${name}`, { method: 'POST', headers: { 'x-presight-token': hash.slice(1) }, body: JSON.stringify(body) });
    if (!answer.ok) throw new Error(`${name}: ${answer.status} ${await answer.text()}`);
    return answer.json();
  };
  run('features', room, '--class', 'video', '--out', 'killed.layer.json', '--kinds', 'corner,crease');
  for (let round = 0; round < rounds; round++) {
    const { address, stop } = await start('--layer', 'killed.layer.json');
    let { version, offered } = await post(address, 'state', {});
    if (offered) ({ version } = await post(address, 'restore', { version, keep: true }));
    const ids = (await post(address, 'features', {})).ids;
    const present = new Set(ids);
    const acknowledged = new Set(present);
    const files = [readFileSync(join(folder, 'killed.layer.json'), 'utf8')];
    setTimeout(() => stop('SIGKILL'), 20 + ((round * 37) % 160));
    let under = null;
    try {
      for (const id of ids) {
        under = id;
        ({ version } = await post(address, 'change', { version, label: 'drop', change: { op: 'delete_feature', class: 'video', feature: id } }));
        acknowledged.delete(id);
        under = null;
        if (id % 5 === 0) ({ version } = await post(address, 'save', { version }));
        if (id % 3 === 0) {
          ({ version } = await post(address, 'undo', { version }));
          acknowledged.add(id);
        }
      }
    } catch { /* killed */ }
    await stop('SIGKILL');
    JSON.parse(readFileSync(join(folder, 'killed.layer.json'), 'utf8'));
    const again = await start('--layer', 'killed.layer.json');
    const state = await post(again.address, 'state', {});
    if (state.offered?.fits) await post(again.address, 'restore', { version: state.version, keep: true });
    const left = new Set((await post(again.address, 'features', {})).ids);
    // What was under way may be done or not.
    const wrong = [...present].filter(id => left.has(id) !== acknowledged.has(id));
    assert.ok(wrong.length === 0 || (wrong.length === 1), `round ${round}: ${wrong} differ, ${under} was under way`);
    await again.stop('SIGTERM');
    rmSync(join(folder, 'killed.layer.json.edits'), { force: true });
    writeFileSync(join(folder, 'killed.layer.json'), files[0]);
  }
});

test('the map is that of the command, and the page shows it', async () => {
  mounted();
  run('features', room, '--worth', '--sensor', 'camera.toml', '--layer', 'many.layer.json', '--spacing', '0.5', '--csv', 'worth.csv');
  const { address, stop } = await start('--layer', 'many.layer.json');
  const page = await open(address);
  await page.fill('#pose', '0.3,0.35,1.2,0,12,38');
  await page.locator('#pose').press('Enter');
  await page.waitForFunction(() => window.presight.pose.startsWith('0.3,0.35,1.2,'));
  await page.fill('#m-spacing', '0.5');
  await page.click('#map-go');
  await page.waitForFunction(() => window.presight.worth && window.presight.worth.done === window.presight.worth.of, null, { timeout: 120_000 });
  const cells = await page.evaluate(() => [...window.presight.worth.cells.values()]);
  const rows = readFileSync(join(folder, 'worth.csv'), 'utf8').trim().split('\n').slice(1).map(line => line.split(',').map(word => (word === 'inf' ? Infinity : Number(word))));
  const told = cells.sort((a, b) => a[1] - b[1] || a[0] - b[0]).map(c => c.slice(2).map(v => v ?? Infinity));
  assert.deepEqual(told, rows);
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('a picture of the page for the guides', { skip: !process.env.PRESIGHT_EDITOR_PICTURE }, async () => {
  mounted();
  const few = ['--worth', '--sensor', 'camera.toml', '--spacing', '0.4', '--thin', '--out', 'room.video.layer.json'];
  run('features', 'room.glb', ...few);
  const { address, stop } = await start('--sensor', 'camera.toml', '--layer', 'room.video.layer.json');
  const page = await open(address);
  await page.fill('#m-spacing', '0.25');
  await page.click('#map-go');
  await page.waitForFunction(() => window.presight.worth?.done === window.presight.worth?.of && window.presight.worth, null, { timeout: 300_000 });
  await clickPixel(page, EDGE);
  await page.waitForTimeout(1500);
  const whole = await page.screenshot();
  const blank = await browser.newPage();
  // Smaller, and in fewer colours: text and lines stay, and the file is a third.
  const small = await blank.evaluate(async data => {
    const image = new Image();
    image.src = `data:image/png;base64,${data}`;
    await image.decode();
    const canvas = document.createElement('canvas');
    [canvas.width, canvas.height] = [Math.round(image.width * 0.6), Math.round(image.height * 0.6)];
    const context = canvas.getContext('2d');
    context.imageSmoothingQuality = 'high';
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    const all = context.getImageData(0, 0, canvas.width, canvas.height);
    all.data.forEach((c, i) => { all.data[i] = i % 4 === 3 ? 255 : Math.min(255, Math.round(c / 17) * 17); });
    context.putImageData(all, 0, 0);
    return canvas.toDataURL('image/png').split(',')[1];
  }, whole.toString('base64'));
  await blank.close();
  writeFileSync(process.env.PRESIGHT_EDITOR_PICTURE, Buffer.from(small, 'base64'));
  assert.ok(small.length * 0.75 < 200_000, `${small.length * 0.75} bytes`);
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});


const where = page => page.inputValue('#pose');

test('the address holds the view: reload keeps it, back and forward go through the views', async () => {
  const { address, stop } = await start();
  const page = await open(address);
  const views = [];
  for (const key of ['w', '[']) {
    // Views of one movement share an entry of the history: these are two movements.
    await page.waitForTimeout(1800);
    await page.locator('#stage').press(key);
    await page.waitForFunction(() => window.presight.pose === document.getElementById('pose').value);
    await page.waitForTimeout(300);
    views.push(await where(page));
  }
  assert.ok(page.url().endsWith(`@${views[1]}`), page.url());
  await page.reload();
  await full(page);
  assert.equal(await where(page), views[1]);
  await page.goBack();
  await page.waitForFunction(view => document.getElementById('pose').value === view, views[0]);
  await page.goForward();
  await page.waitForFunction(view => document.getElementById('pose').value === view, views[1]);
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('Alt and drag orbits around what the middle shows, a right drag pans, and a kept view is found again', async () => {
  const { address, stop } = await start();
  const page = await open(address);
  const middle = () => page.evaluate(() => {
    const { range, size: [w, h] } = window.presight.frame();
    return range[Math.floor(h / 2) * w + Math.floor(w / 2)];
  });
  const box = await page.locator('#stage').boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const drag = async (dx, dy, options) => {
    const { full: since } = await page.evaluate(() => window.presight);
    await page.mouse.move(x, y);
    await page.mouse.down(options);
    await page.mouse.move(x + dx, y + dy, { steps: 4 });
    await page.mouse.up(options);
    await full(page, since);
  };
  const [before, from] = [await middle(), (await where(page)).split(',').map(Number)];
  await page.keyboard.down('Alt');
  await drag(20, 0);
  await page.keyboard.up('Alt');
  const orbited = (await where(page)).split(',').map(Number);
  assert.ok(Math.abs(await middle() - before) < 0.02 * before && orbited[5] !== from[5], `${before}: ${orbited}`);
  await drag(30, 0, { button: 'right' });
  const panned = (await where(page)).split(',').map(Number);
  assert.deepEqual(panned.slice(3), orbited.slice(3));
  assert.ok(Math.hypot(panned[0] - orbited[0], panned[1] - orbited[1]) > 0.05, String(panned));
  await page.click('#bookmark');
  await page.locator('#stage').press('w');
  await page.locator('#views button').click();
  assert.equal(await where(page), panned.join(','));
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('the measured image stands beside the predicted one, in its colours', async () => {
  run('predict', 'room.glb', '--sensor', 'video-camera', '--pose', POSE, '--out', 'measured.exr');
  const { address, stop } = await start('--measured', 'measured.exr');
  const page = await open(address);
  // The measurement is the prediction: away from the borders of polygons, which only a prediction has, all pixels agree.
  const differ = await page.evaluate(() => {
    const data = id => {
      const canvas = document.getElementById(id);
      return new Uint32Array(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer);
    };
    const [a, b] = [data('image'), data('measured')];
    return a.length === b.length ? a.filter((pixel, i) => pixel !== b[i]).length / a.length : 1;
  });
  assert.ok(differ < 0.2, `${differ} of the pixels differ`);
  assert.deepEqual(page.faults, []);
  await page.close();
  await stop();
});

test('in a narrow window nothing overlaps and nothing is cut off', async () => {
  const { address, stop } = await start();
  const page = await open(address);
  await page.setViewportSize({ width: 700, height: 900 });
  const faults = await page.evaluate(() => {
    const parts = 'header>*,nav>*,#stage,#under>*,#where>*,.keys,#panel,#map-tools>*,#plan,#filters>*,#list,#make>*';
    const shown = [...document.querySelectorAll(parts)].map(part => [part, part.getBoundingClientRect()]).filter(([, b]) => b.width && b.height);
    const name = part => part.id || part.textContent;
    const out = shown.filter(([, b]) => b.left < -1 || b.right > innerWidth + 1).map(([part]) => `${name(part)} is cut off`);
    shown.forEach(([p, a], i) => shown.slice(i + 1).forEach(([q, b]) => {
      const across = Math.min(a.right, b.right) - Math.max(a.left, b.left), down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (across > 1 && down > 1 && !p.contains(q)) out.push(`${name(p)} covers ${name(q)}`);
    }));
    return out;
  });
  assert.deepEqual(faults, []);
  await page.close();
  await stop();
});
