#!/usr/bin/env python3
"""Batches where several processes share a store: each node lists, shows, cancels and reads any of
them, and one whose process is killed goes on elsewhere. Over a shared folder and over a bucket."""
import hashlib
import json
import os
import pathlib
import signal
import subprocess
import tempfile

import bucket_test
import harness
import nodes_test
from harness import CUBE, wait_until

OPTIONS = {'resolution': 40, 'format': 'xyz'}


class FolderTest(nodes_test.NodesCase):
    """Outputs in the folder that the nodes share."""

    def setUp(self):
        super().setUp()
        self.models = pathlib.Path(self.folder.name) / 'models'
        (self.models / 'sub').mkdir(parents=True)

    def put_models(self, count):
        for i in range(count):
            (self.models / 'sub' / f'{i:03}.obj').write_bytes(CUBE + b'# %d\nv 9 9 %d\n' % (i, i))

    def node_options(self):
        return ()

    def serve(self, *more, **rest):
        return super().serve('--memory', '1G', *self.node_options(), *more, **rest)

    def options(self, url=None):
        options = list(super().options(url))
        if '--models' in options:
            del options[options.index('--models'):options.index('--models') + 2]
        return (*options, '--models', str(self.models))

    def ask(self, node, path, *options, body=None):
        answer = node.curl(path, *options, body=None if body is None else json.dumps(body).encode())
        return answer.status, answer.json() if answer.body else None

    def create(self, node, **request):
        status, batch = self.ask(node, '/v1/batches', '-H', 'Content-Type: application/json',
                                 body={'options': OPTIONS, **request})
        self.assertEqual(status, 202, batch)
        return batch['id']

    def batch(self, node, id):
        status, batch = self.ask(node, f'/v1/batches/{id}')
        self.assertEqual(status, 200, batch)
        return batch

    def end_of(self, node, id):
        return wait_until(lambda: (batch := self.batch(node, id))['state'] not in
                          ('queued', 'running') and batch, 'the batch to end', patience=120)

    def manifest(self, node, id):
        text = node.curl(f'/v1/batches/{id}/manifest').body.decode()
        return {line['path']: line for line in map(json.loads, text.splitlines())}

    def holder(self, id):
        """The node that runs it."""
        rows = self.sql('SELECT p.name FROM strata.batches b JOIN strata.processes p ON p.id = b.holder'
                        f" WHERE b.id = '{id}' AND b.state = 2")
        pid = int(rows[0][0].rsplit(':', 1)[1]) if rows else None
        return next((node for node in self.nodes if node.process.pid == pid), None)

    def assertOutputsOfTheCommand(self, node, id):
        with tempfile.TemporaryDirectory() as out:
            subprocess.run([harness.strata(), 'batch', self.models, '-o', out, '--quiet',
                            '--resolution', '40', '--format', 'xyz'], check=True)
            lines = self.manifest(node, id)
            outputs = {str(path.relative_to(out)): path.read_bytes()
                       for path in pathlib.Path(out).rglob('*.xyz')}
            self.assertEqual({line['output'] for line in lines.values()}, set(outputs))
            for name in sorted(outputs)[::7]:
                got = node.curl(f'/v1/batches/{id}/output?path={name}')
                self.assertEqual(got.status, 200, got.body)
                self.assertEqual(hashlib.sha256(got.body).hexdigest(),
                                 hashlib.sha256(outputs[name]).hexdigest())

    def test_any_node_knows_any_batch(self):
        self.lease = 60
        self.put_models(20)
        first, second, third = (self.serve() for _ in range(3))
        ids = [self.create(node) for node in (first, second, first)]
        events = third.curl(f'/v1/batches/{ids[0]}/events').body.decode()
        last = json.loads(events.strip().rsplit('data: ', 1)[1])
        self.assertEqual((last['state'], int(last['models'])), ('succeeded', 20))
        for id in ids:
            ended = self.end_of(second, id)
            self.assertEqual((ended['state'], int(ended['sampled'])), ('succeeded', 20), ended)
        for node in (first, second, third):
            status, page = self.ask(node, '/v1/batches?page_size=2')
            self.assertEqual(status, 200)
            listed = [batch['id'] for batch in page['batches']]
            status, page = self.ask(node, f'/v1/batches?page_token={page["next_page_token"]}')
            listed += [batch['id'] for batch in page['batches']]
            self.assertEqual(listed, sorted(ids, key=lambda id: self.batch(node, id)['created'],
                                            reverse=True))
            self.assertOutputsOfTheCommand(node, ids[1])
            self.assertEqual(self.ask(node, '/v1/batches/' + 32 * '0')[0], 404)

    def test_any_node_cancels_any_batch(self):
        self.lease = 60
        self.put_models(100)
        nodes = [self.serve() for _ in range(2)]
        long = {**OPTIONS, 'resolution': 400}  # A second or so for each model; all are cancelled.
        running = self.create(nodes[0], options=long)
        holder = wait_until(lambda: self.holder(running), 'the batch to run')
        wait_until(lambda: int(self.batch(nodes[1], running).get('models', 0)) > 0, 'it to begin')
        other = next(node for node in nodes if node is not holder)
        self.assertEqual(self.ask(other, f'/v1/batches/{running}', '-X', 'DELETE')[0], 200)
        ended = self.end_of(other, running)
        self.assertEqual(ended['state'], 'cancelled', ended)
        self.assertEqual(self.batch(holder, running)['state'], 'cancelled')
        # One that waits ends at once.
        busy = [self.create(nodes[0], options=long) for _ in range(2)]
        for id in busy:
            wait_until(lambda: self.holder(id), 'both nodes to be busy')
        waiting = self.create(nodes[0])
        status, batch = self.ask(nodes[1], f'/v1/batches/{waiting}', '-X', 'DELETE')
        self.assertEqual((status, batch['state']), (200, 'cancelled'))
        for id in busy:
            self.ask(nodes[1], f'/v1/batches/{id}', '-X', 'DELETE')
            self.assertEqual(self.end_of(nodes[0], id)['state'], 'cancelled')

    def stopped_in_the_middle(self):
        """A batch of 120 models of which some are sampled, and whose node is stopped: the nodes, its id,
        who ran it, who not."""
        self.put_models(120)
        nodes = [self.serve() for _ in range(2)]
        for _ in range(20):
            id = self.create(nodes[0])
            goes_on = f"SELECT 1 FROM strata.batches WHERE id = '{id}' AND ended IS NULL"
            holder = wait_until(lambda: self.holder(id) or not self.sql(goes_on), 'the batch to run')
            if holder is True:
                continue  # It was quicker.
            other = next(node for node in nodes if node is not holder)
            wait_until(lambda: int(self.batch(other, id).get('sampled', 0)) > 20 or
                       not self.sql(goes_on), 'some to be sampled')
            holder.process.send_signal(signal.SIGSTOP)
            if self.sql(goes_on):
                return nodes, id, holder, other
            holder.process.send_signal(signal.SIGCONT)
        self.fail('no batch was stopped before its end')

    def interrupted(self, number):
        """A batch whose node gets a signal in the middle; it must end elsewhere."""
        nodes, id, holder, other = self.stopped_in_the_middle()
        if number != signal.SIGSTOP:
            holder.process.send_signal(number)
            holder.process.send_signal(signal.SIGCONT)
        ended = self.end_of(other, id)
        self.assertEqual(ended['state'], 'succeeded', ended)
        self.assertEqual(int(ended.get('sampled', 0)) + int(ended.get('unchanged', 0)), 120)
        self.assertOutputsOfTheCommand(other, id)
        return holder, id

    def test_a_batch_of_a_killed_node_goes_on_at_another(self):
        _, id = self.interrupted(signal.SIGKILL)
        [[attempts]] = self.sql(f"SELECT attempts FROM strata.batches WHERE id = '{id}'")
        self.assertGreater(int(attempts), 1)  # 2, where no other lease ran out.

    def test_a_batch_of_a_node_that_ends_is_given_back(self):
        self.lease = 60  # It is not waited for.
        _, id = self.interrupted(signal.SIGTERM)
        self.assertEqual(self.sql(f"SELECT attempts FROM strata.batches WHERE id = '{id}'"), [['1']])

    def test_a_paused_node_that_wakes_does_not_end_anothers_batch(self):
        holder, id = self.interrupted(signal.SIGSTOP)
        before = self.sql(f"SELECT revision, text FROM strata.batches WHERE id = '{id}'")
        holder.process.send_signal(signal.SIGCONT)
        wait_until(lambda: holder.events('batch_lost'), 'the sleeper to notice')
        self.assertEqual(self.sql(f"SELECT revision, text FROM strata.batches WHERE id = '{id}'"),
                         before)
        self.assertEqual(self.batch(holder, id)['state'], 'succeeded')

    def test_of_one_that_is_lost_at_its_very_end_the_row_is_shown(self):
        self.put_models(2)
        node = self.serve()
        self.sql('CREATE FUNCTION lose() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN'
                 ' RETURN NULL; END $$; CREATE TRIGGER lose BEFORE UPDATE ON strata.batches'
                 ' FOR EACH ROW WHEN (NEW.state = 3) EXECUTE FUNCTION lose()')
        id = self.create(node)
        wait_until(lambda: node.events('batch_lost'), 'the node to notice')
        # Another process ended it otherwise.
        self.sql('DROP TRIGGER lose ON strata.batches; UPDATE strata.batches SET state = 3,'
                 " holder = 'another', text = replace(text, 'running', 'cancelled'),"
                 f" ended = 1 + created, revision = revision + 1 WHERE id = '{id}'")
        wait_until(lambda: self.batch(node, id)['state'] == 'cancelled', 'the node to show it')

    def test_one_that_its_living_node_gave_up_is_taken_up_again(self):
        self.put_models(3)
        node = self.serve()
        id = self.create(node)
        self.end_of(node, id)
        # As it is left where the database was away for longer than the lease, and nobody else there.
        self.sql('UPDATE strata.batches SET state = 2, ended = NULL, revision = revision + 1,'
                 f" holder = (SELECT id FROM strata.processes) WHERE id = '{id}'")
        ended = self.end_of(node, id)
        self.assertEqual((ended['state'], int(ended['unchanged'])), ('succeeded', 3), ended)
        self.assertEqual(self.sql('SELECT state, attempts FROM strata.batches'), [['3', '2']])

    def test_one_that_kills_its_nodes_fails_with_what_happened(self):
        self.put_models(3)
        node = self.serve('--max-attempts', '2')
        id = self.create(node)
        self.end_of(node, id)
        # As two processes that died would leave it.
        self.sql(f"UPDATE strata.batches SET state = 2, attempts = 2, ended = NULL, holder = 'gone'"
                 f" WHERE id = '{id}'")
        batch = wait_until(lambda: (b := self.batch(node, id))['state'] == 'failed' and b, 'its end')
        self.assertIn('begun 2 times', batch['error']['detail'])


class BucketTest(FolderTest, bucket_test.BucketCase):
    """Outputs in the bucket, the folders of the nodes their own."""


    def test_what_a_paused_node_had_does_not_replace_what_another_has(self):
        nodes, id, holder, other = self.stopped_in_the_middle()
        paused = [holder.process.pid, *map(int, holder.children())]
        for pid in paused[1:]:  # One that has ended stays there until its parent looks.
            os.kill(pid, signal.SIGSTOP)
        self.assertEqual(self.end_of(other, id)['state'], 'succeeded')
        before = other.curl(f'/v1/batches/{id}/manifest').body
        self.assertEqual(before.count(b'\n'), 120)
        for pid in reversed(paused):
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: holder.events('batch_lost'), 'the sleeper to notice')
        for node in nodes:
            self.assertEqual(node.curl(f'/v1/batches/{id}/manifest').body, before)


# The cases of FolderTest hold here; those of a bucket's stores have their own file.
if __name__ == '__main__':
    nodes_test.main()
