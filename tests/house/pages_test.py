#!/usr/bin/env python3
"""The manual and the shells' completions say what --help says, and work."""
import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

ARGUMENTS = None
PATIENCE = 60


def run(*command, **options):
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, **options)


def help_of(*command):
    done = run(ARGUMENTS.strata, *command, '--help')
    assert done.returncode == 0, done.stderr
    return done.stdout


def commands():
    """The commands that `strata --help` names in its usage."""
    named = re.findall(r'^(?:Usage:| ) +strata ([a-z]+) ', help_of(), re.MULTILINE)
    return list(dict.fromkeys(named))


def options(help_text):
    """Every name of an option that stands at the beginning of a line of the help."""
    names = set()
    for line in re.findall(r'^  (-[^\s]+)', help_text, re.MULTILINE):
        names.update(line.split(','))
    return names


def page(name):
    return pathlib.Path(ARGUMENTS.pages) / 'man' / f'{name}.1'


def completion(name):
    return pathlib.Path(ARGUMENTS.pages) / 'completion' / name


class Manual(unittest.TestCase):

    def test_help_names_the_commands_that_are_known(self):
        self.assertLessEqual({'sample', 'scan', 'merge', 'info'}, set(commands()))

    def test_every_command_has_a_page_with_every_option_of_its_help(self):
        for command in commands():
            text = page(f'strata-{command}').read_text().replace('\\-', '-')
            for option in options(help_of(command)):
                self.assertIn(f'\\fB{option}\\fR', text, f'strata-{command}(1)')

    def test_the_page_of_strata_lists_every_command(self):
        text = page('strata').read_text().replace('\\-', '-')
        for command in commands():
            self.assertIn(f'\\fBstrata {command}\\fR', text)
            self.assertIn(f'strata-{command} (1)', text)

    def test_a_page_keeps_the_words_of_the_help(self):
        done = run('man', '-l', page('strata-sample'), env={**os.environ, 'MANWIDTH': '1000'}) \
            if shutil.which('man') else self.skipTest('man is not here')
        plain = ' '.join(done.stdout.split())
        self.assertIn('exp(-L d), d in edges; 0 = uniform.', plain)
        self.assertIn('strata sample model.ply -o model.drc', plain)

    def check(self, program, *command):
        if not shutil.which(program):
            self.skipTest(f'{program} is not here')
        pages = sorted(page('strata').parent.glob('*.1'))
        self.assertGreaterEqual(len(pages), 5)
        for each in pages:
            done = run(program, *command, each, env={**os.environ, 'MANWIDTH': '80'})
            self.assertEqual((done.returncode, done.stderr), (0, ''), each)
            if program == 'mandoc':
                self.assertEqual(done.stdout, '')

    def test_mandoc_has_nothing_to_say(self):
        # Of style it would: a line of NAME may not be broken.
        self.check('mandoc', '-T', 'lint', '-W', 'warning')

    def test_groff_has_nothing_to_say(self):
        self.check('groff', '-ww', '-man', '-z')

    def test_man_has_nothing_to_say(self):
        self.check('man', '--warnings', '-l')


class Bash(unittest.TestCase):

    def complete(self, *words, cwd=None):
        """What Tab offers after these words, the last of which may be empty."""
        script = ('source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); '
                  '_strata; printf "%s\\n" "${COMPREPLY[@]}"')
        done = run('bash', '-c', script, 'bash', completion('strata'), 'strata', *words, cwd=cwd)
        self.assertEqual((done.returncode, done.stderr), (0, ''))
        return set(done.stdout.split('\n')) - {''}

    def test_commands_are_offered_first(self):
        self.assertLessEqual({*commands(), '--help', '--version'}, self.complete(''))
        self.assertEqual(self.complete('sam'), {'sample'})

    def test_every_option_of_every_help_is_offered(self):
        for command in commands():
            self.assertEqual(self.complete(command, '-'), options(help_of(command)), command)

    def test_an_option_that_takes_words_offers_them(self):
        self.assertEqual(self.complete('sample', 'a.ply', '--integrator', ''), {'exact', 'subdivide'})
        self.assertEqual(self.complete('sample', '--integrator', '=', 'su'), {'subdivide'})
        self.assertEqual(self.complete('sample', '--integrator', '='), {'exact', 'subdivide'})

    def test_files_are_offered_where_a_file_may_stand(self):
        with tempfile.TemporaryDirectory() as folder:
            (pathlib.Path(folder) / 'a mesh.ply').touch()
            (pathlib.Path(folder) / 'below').mkdir()
            both = {'a mesh.ply', 'below'}
            self.assertEqual(self.complete('sample', '', cwd=folder), both)
            self.assertEqual(self.complete('sample', 'a mesh.ply', '-o', '', cwd=folder), both)
            self.assertEqual(self.complete('sample', '--scratch', '', cwd=folder), {'below'})
            self.assertEqual(self.complete('sample', '--seed', '', cwd=folder), set())

    def test_tab_completes_in_a_shell_with_a_terminal(self):
        with tempfile.TemporaryDirectory() as folder:
            program = pathlib.Path(folder) / 'strata'
            program.write_text('#!/bin/sh\nprintf "<%s>" "$@" > "$0.typed"\n')
            program.chmod(0o755)
            typed = f'source {completion("strata")}\nstrata sa\t--integ\tsub\tX\nexit\n'
            terminal, end = os.openpty()
            os.write(terminal, typed.encode())
            shell = subprocess.Popen(
                ['bash', '--norc', '--noprofile', '-i'], stdin=end, stdout=end, stderr=end,
                env={'PATH': f'{folder}:{os.environ["PATH"]}', 'TERM': 'dumb', 'INPUTRC': '/dev/null'})
            os.close(end)
            shell.wait(PATIENCE)
            os.close(terminal)
            self.assertEqual(pathlib.Path(f'{program}.typed').read_text(),
                             '<sample><--integrator><subdivide><X>')


class OtherShells(unittest.TestCase):

    def test_zsh_and_fish_read_their_files_which_hold_every_option(self):
        for shell, name in (('zsh', '_strata'), ('fish', 'strata.fish')):
            text = completion(name).read_text()
            for command in commands():
                for option in options(help_of(command)):
                    written = option if shell == 'zsh' else f' -{"l" if option[1] == "-" else "s"} ' + \
                        option.lstrip('-')
                    self.assertIn(written, text, f'{command} in {name}')
            if shutil.which(shell):
                done = run(shell, '-n', completion(name))
                self.assertEqual((done.returncode, done.stderr), (0, ''), name)

    def test_fish_offers_words(self):
        if not shutil.which('fish'):
            self.skipTest('fish is not here')
        asked = f'source {completion("strata.fish")}; complete -C "strata sample --integrator "'
        with tempfile.TemporaryDirectory() as home:
            done = run('fish', '--no-config', '-c', asked, env={**os.environ, 'HOME': home})
        offered = {line.split('\t')[0] for line in done.stdout.splitlines()}
        self.assertEqual(offered, {'exact', 'subdivide'})


def main():
    global ARGUMENTS
    parser = argparse.ArgumentParser()
    parser.add_argument('--strata', required=True)
    parser.add_argument('--pages', required=True)
    ARGUMENTS = parser.parse_args()
    ARGUMENTS.pages = os.path.abspath(ARGUMENTS.pages)
    unittest.main(argv=sys.argv[:1], verbosity=2)


if __name__ == '__main__':
    main()
