// A service of the test's own on loopback.
import { spawn, spawnSync } from 'node:child_process';
import { once } from 'node:events';
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { createInterface } from 'node:readline';

export const source = process.env.SOURCE;
export const mesh = readFileSync(join(source, 'models/spot.obj'));

/** A free port, and none that the system gives to outgoing connections: it is still free when a service
 *  that was killed comes back to it. */
async function freePort() {
  const range = readFileSync('/proc/sys/net/ipv4/ip_local_port_range', 'utf8');
  const lowest = Number(range.split('\t')[0]);
  for (let tries = 0; tries < 1000; ++tries) {
    const probe = createServer();
    const listening = new Promise((resolve) => {
      probe.once('error', () => resolve(false));
      probe.once('listening', () => resolve(true));
    });
    probe.listen(10_000 + Math.floor(Math.random() * (lowest - 10_000)), '127.0.0.1');
    if (!await listening) continue;
    const { port } = probe.address();
    await new Promise((resolve) => { probe.close(resolve); });
    return port;
  }
  throw new Error(`no free port below ${lowest}`);
}

/** `strata serve` with a data folder, which outlives its crashes. */
export class Server {
  constructor(options = []) {
    this.folder = mkdtempSync(join(tmpdir(), 'strata-clients-'));
    mkdirSync(join(this.folder, 'scratch'));
    this.options = options;
    this.port = 0;
  }

  /** Starts it; the second time on the port of the first. */
  async start() {
    this.port ||= await freePort();
    this.process = spawn(
      process.env.STRATA,
      ['serve', '--http', `127.0.0.1:${this.port}`, '--grpc', 'off', '--log-format', 'json',
       '--data', join(this.folder, 'data'), '--scratch', join(this.folder, 'scratch'),
       ...this.options],
      { cwd: this.folder, stdio: ['ignore', 'ignore', 'pipe'] });
    this.log = [];
    const lines = createInterface({ input: this.process.stderr });
    const serving = new Promise((resolve, reject) => {
      lines.on('line', (line) => {
        this.log.push(line);
        const event = line.startsWith('{') ? JSON.parse(line) : {};
        if (event.event === 'serving') resolve(event);
      });
      this.process.on('exit', (code) => reject(new Error(`ended with ${code}: ${this.log}`)));
    });
    this.port = Number((await serving).http.split(':').pop());
    this.url = `http://127.0.0.1:${this.port}`;
    return this;
  }

  async end(signal) {
    const ended = once(this.process, 'exit');
    this.process.kill(signal);
    return (await ended)[0];
  }

  /** As kill -9 leaves it. */
  async kill() { await this.end('SIGKILL'); }

  async stop() {
    const status = await this.end('SIGTERM');
    rmSync(this.folder, { recursive: true });
    if (status !== 0) throw new Error(`the server ended with ${status}: ${this.log.slice(-5)}`);
  }

  /** The body of an answer of 200. */
  async bytes(path, init) {
    const answer = await fetch(this.url + path, init);
    const body = Buffer.from(await answer.arrayBuffer());
    if (answer.status !== 200) throw new Error(`${path}: ${answer.status} ${body}`);
    return body;
  }
}

/** A file of keys in `folder`: { path, full, read }. */
export function makeKeys(folder) {
  const made = { path: join(folder, 'keys') };
  let lines = '';
  for (const role of ['full', 'read']) {
    const done = spawnSync(process.env.STRATA, ['key', role, '--role', role], { encoding: 'utf8' });
    if (done.status !== 0) throw new Error(done.stderr);
    made[role] = done.stderr.trim().split(/\s+/).pop();
    lines += done.stdout;
  }
  writeFileSync(made.path, lines);
  return made;
}
