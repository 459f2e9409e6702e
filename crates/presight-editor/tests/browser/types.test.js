// The page's types, as its comments state them.

import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
import { test } from 'node:test';

test('the page keeps the types that its comments state', () => {
  const { status, stdout } = spawnSync('node', ['node_modules/typescript/bin/tsc', '--project', 'tsconfig.json'], { encoding: 'utf8' });
  assert.equal(status, 0, stdout);
});
