// The figures of benches/RESULTS.md on the editor: node figures.js HOSPITAL.glb HALL.glb [times]
// PRESIGHT names the command, CHROMIUM the browser. Prints a table in Markdown.

import { execFileSync, spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { chromium } from 'playwright-core';

const command = resolve(process.env.PRESIGHT ?? '../../../../target/debug/presight');
const [hospital, hall] = process.argv.slice(2, 4).map(name => resolve(name));
const times = Number(process.argv[4] ?? 40);
const folder = mkdtempSync(join(tmpdir(), 'presight-figures-'));
const run = (...args) => execFileSync(command, args, { cwd: folder, encoding: 'utf8', maxBuffer: 1 << 28 });
const median = values => [...values].sort((a, b) => a - b)[values.length >> 1];
const timed = work => {
  const start = performance.now();
  work();
  return performance.now() - start;
};
const rows = [];
const row = (what, measured, against, ratio, most) => {
  rows.push(`| ${what} | ${measured} | ${against} | ${ratio} | ${most} |`);
  console.error(rows.at(-1));
};
const ms = x => `${x.toFixed(x < 10 ? 1 : 0)} ms`;

async function start(scene, ...args) {
  const child = spawn(command, ['edit', scene, '--sensor', 'video-camera', '--no-open', '--backend', 'cpu', ...args], { cwd: folder, stdio: ['ignore', 'pipe', 'inherit'] });
  const address = await new Promise(done => child.stdout.once('data', data => done(String(data).trim())));
  return { address, stop: () => child.kill('SIGKILL') };
}

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: ['--no-sandbox', '--disable-gpu'] });
const still = page => page.waitForFunction(() => window.presight.full > 0 && window.presight.full === window.presight.seq, null, { timeout: 120_000 });

async function open(address) {
  const page = await browser.newPage({ viewport: { width: 1400, height: 860 } });
  await page.goto(address);
  await still(page);
  await page.waitForTimeout(1500);
  return page;
}

/** Milliseconds from a pointer's move to the drawn canvas, and those that the server reports, per move. */
const drag = (page, count) => page.evaluate(async count => {
  const stage = document.getElementById('stage');
  const box = stage.getBoundingClientRect();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const event = (kind, dx) => stage.dispatchEvent(new PointerEvent(kind, { clientX: x + dx, clientY: y, button: 0, pointerId: 1, bubbles: true }));
  stage.setPointerCapture = () => {};
  event('pointerdown', 0);
  event('pointermove', 5);
  const [all, server] = [[], []];
  for (let i = 0; i < count; i++) {
    await new Promise(done => setTimeout(done, 30));
    const before = window.presight.seq;
    const start = performance.now();
    event('pointermove', 6 + i);
    while (window.presight.seq === before) await new Promise(done => setTimeout(done));
    all.push(window.presight.at - start);
    server.push(window.presight.frame().ms);
  }
  event('pointerup', 6 + count);
  return { all, server };
}, count);

/** Serves the same page with answers that were recorded: what fetching and drawing cost without a prediction. */
async function replayed(page, address) {
  const { origin, hash } = new URL(address);
  const record = async (name, body) => {
    const headers = { 'x-presight-token': hash.slice(1) };
    const answer = await fetch(`${origin}/${name}`, { method: 'POST', headers, body: JSON.stringify(body) });
    return { kind: answer.headers.get('content-type'), bytes: Buffer.from(await answer.arrayBuffer()) };
  };
  const pose = await page.evaluate(() => window.presight.pose.split(',').map(Number));
  const answers = {
    state: await record('state', {}), features: await record('features', {}),
    frame: await record('frame', { pose, outputs: ['range', 'polygon_id'], features: false }),
    plan: await record('plan', { height: 1 }), regions: await record('regions', { pose, sigmas: [0, 0, 0, 0, 0, 0], confidence: 0.9 }),
  };
  const kinds = { html: 'text/html', css: 'text/css', js: 'text/javascript', svg: 'image/svg+xml' };
  const server = createServer((request, answer) => {
    const name = request.url.slice(1) || 'index.html';
    if (request.method === 'GET') {
      answer.setHeader('content-type', kinds[name.split('.').pop()]);
      return answer.end(readFileSync(resolve('../../src/page', name)));
    }
    request.resume().on('end', () => {
      const recorded = answers[name];
      answer.setHeader('content-type', recorded.kind);
      answer.end(recorded.bytes);
    });
  }).listen(0, '127.0.0.1');
  await new Promise(done => server.on('listening', done));
  return { address: `http://127.0.0.1:${server.address().port}/`, stop: () => server.close() };
}

const uncheck = (page, id) => page.evaluate(id => { document.getElementById(id).checked = false; }, id);

// Frames, features and regions in the hospital.
run('features', hospital, '--class', 'video', '--out', 'all.layer.json');
const args = ['--layer', 'all.layer.json'];
{
  const editor = await start(hospital, ...args);
  const page = await open(editor.address);
  await uncheck(page, 'with-seen');
  await drag(page, 5);
  const plain = await drag(page, times);
  const replay = await replayed(page, editor.address);
  const other = await open(replay.address);
  await uncheck(other, 'with-seen');
  await drag(other, 5);
  const drawn = await drag(other, times);
  const [a, p, d] = [median(plain.all), median(plain.server), median(drawn.all)];
  row('pointer to drawn canvas', ms(a), `${ms(p)} + ${ms(d)} prediction, same bytes fetched and drawn`, (a / (p + d)).toFixed(2), '1.2, and 33 ms');
  await other.close();
  replay.stop();
  await page.evaluate(() => { document.getElementById('with-seen').checked = true; });
  await drag(page, 5);
  const seen = await drag(page, times);
  row('the same with all features, the seen ones drawn', ms(median(seen.all)), `${ms(a)} without features`, (median(seen.all) / a).toFixed(2), '2');
  await page.waitForTimeout(1000);
  const regions = await page.evaluate(async times => {
    const slider = document.getElementById('s-position');
    const [all, server] = [[], []];
    const fetched = window.fetch;
    window.fetch = async (...args) => {
      const answer = await fetched(...args);
      if (String(args[0]).endsWith('/regions')) {
        const bytes = await answer.clone().arrayBuffer();
        const length = new DataView(bytes).getUint32(0, true);
        server.push(JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length))).ms);
      }
      return answer;
    };
    for (let i = 0; i < times / 4; i++) {
      await new Promise(done => setTimeout(done, 30));
      const before = window.presight.regions;
      const start = performance.now();
      slider.value = String(0.05 + 0.005 * (i % 3));
      slider.dispatchEvent(new Event('input'));
      while (window.presight.regions === before) await new Promise(done => setTimeout(done));
      all.push(performance.now() - start);
    }
    window.fetch = fetched;
    return { all, server };
  }, times);
  row('regions after a slider', ms(median(regions.all)), `${ms(median(regions.server))} in the library`, (median(regions.all) / median(regions.server)).toFixed(2), '1.5');
  const keys = await page.evaluate(() => {
    const field = document.getElementById('f-text');
    return ['d', 'do', 'doo', 'door', 'doo', '', '1', '12'].map(text => {
      const start = performance.now();
      field.value = text;
      field.dispatchEvent(new Event('input'));
      void document.getElementById('list').offsetHeight;
      return performance.now() - start;
    });
  });
  row('a keystroke in the filter, the slowest', ms(Math.max(...keys)), '', '', '100 ms');
  await page.close();
  editor.stop();
}
// The map of the hall.
{
  run('features', hall, '--class', 'video', '--out', 'hall.layer.json');
  const toml = run('sensors', 'video-camera').replace('[noise]', '[mount]\nxyz = [0, 0, 1.2]\n\n[noise]');
  writeFileSync(join(folder, 'camera.toml'), toml);
  const floor = process.env.FLOOR ?? '0';
  const whole = timed(() => run('features', hall, '--worth', '--sensor', 'camera.toml', '--layer', 'hall.layer.json', '--floor', floor));
  const child = await start(hall, '--layer', 'hall.layer.json');
  const { origin, hash } = new URL(child.address);
  const post = async (name, body) => {
    const answer = await fetch(`${origin}/${name}`, { method: 'POST', headers: { 'x-presight-token': hash.slice(1) }, body: JSON.stringify(body) });
    if (!answer.ok) throw new Error(await answer.text());
    return answer.json();
  };
  let { version } = await post('state', {});
  let since = 0, coarse = 0;
  const asked = () => ({ version, spacing: 1, floor: Number(floor), height: 1.2, budget_ms: 25, since });
  const began = performance.now();
  for (;;) {
    const told = await post('worth', asked());
    since = told.stamp;
    if (!coarse && told.done >= told.of / 16) coarse = performance.now() - began;
    if (told.done === told.of) break;
  }
  const map = performance.now() - began;
  row('the whole map at 1 m, factory hall', `${(map / 1000).toFixed(1)} s`, `${(whole / 1000).toFixed(1)} s, features --worth`, (map / whole).toFixed(2), '1.1');
  row('its first coarse map', `${(coarse / 1000).toFixed(1)} s`, 'features --worth', (coarse / whole).toFixed(2), '0.1');
  const id = (await post('features', {})).ids[100];
  const dropped = performance.now();
  ({ version } = await post('change', { version, label: 'drop', change: { op: 'delete_feature', class: 'video', feature: id } }));
  await post('worth', asked());
  row('the map after a drop', ms(performance.now() - dropped), 'the whole map', ((performance.now() - dropped) / map).toFixed(4), '0.02');
  child.stop();
}
// From the command to the first picture, a store.
{
  run('env', 'create', 'hospital.presight', hospital);
  const pose = '0,0,1.5,0,0,0';
  const predict = median([0, 1, 2].map(() => timed(() => run('predict', 'hospital.presight', '--sensor', 'video-camera', '--pose', pose, '--png', 'a.png', '--backend', 'cpu'))));
  const all = [];
  for (let i = 0; i < 3; i++) {
    const page = await browser.newPage();
    const began = performance.now();
    const editor = await start('hospital.presight', '--pose', pose);
    await page.goto(editor.address);
    await page.waitForFunction(() => window.presight?.seq > 0);
    all.push(performance.now() - began);
    await page.close();
    editor.stop();
  }
  row('presight edit to the first picture, hospital as a store', ms(median(all)), `${ms(predict)}, presight predict`, (median(all) / predict).toFixed(2), '1.5');
}
await browser.close();
rmSync(folder, { recursive: true, force: true });
console.log(['| what | measured | against | ratio | at most |', '|---|---|---|---|---|', ...rows].join('\n'));
