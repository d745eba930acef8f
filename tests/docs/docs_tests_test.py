#!/usr/bin/env python3
"""Whether guide.py and links.py fail where they must: docs_tests_test.py FOLDER."""

import os
import subprocess
import sys
import time
import unittest

HERE = os.path.dirname(os.path.abspath(__file__))
FOLDER = os.path.abspath(sys.argv.pop() if len(sys.argv) > 1 else "docs_tests_test")


def write(name, text):
    path = os.path.join(FOLDER, name)
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "w", encoding="utf-8") as file:
        file.write(text)
    return path


def alive(process):
    try:
        with open(f"/proc/{process}/stat", encoding="utf-8") as file:
            return file.read().split()[2] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def run(program, *arguments):
    done = subprocess.run([sys.executable, os.path.join(HERE, program), *arguments],
                          capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def guide(text):
    return run("guide.py", write("page.md", text), FOLDER, os.path.join(FOLDER, "reader"))


class Guide(unittest.TestCase):
    def test_blocks_share_a_folder_and_a_shell(self):
        code, output = guide("# a\n```sh\nx=3; echo $x > x\n```\ntext\n"
                             "```sh\ntest $x = $(cat x) && test -f README.md\n```\n")
        self.assertEqual(code, 0, output)

    def test_only_sh_runs(self):
        page = "# a\n```text\nfalse\n```\n```\nfalse\n```\n```sh\ntrue\n```\n"
        self.assertEqual(guide(page)[0], 0)

    def test_a_failure_has_its_line_and_output(self):
        code, output = guide("# a\n\n```sh\necho before\ntrue\nls /no/such/file\necho after\n```\n")
        self.assertEqual(code, 1)
        self.assertRegex(output, r'page\.md:6: "ls /no/such/file" ended with 2')
        self.assertIn("before", output)
        self.assertNotIn("after", output)

    def test_what_is_left_running_is_ended(self):
        code, output = guide("# a\n```sh\nsleep 1000 & echo $! > pid\n```\n")
        self.assertEqual(code, 0, output)
        with open(os.path.join(FOLDER, "reader", "pid"), encoding="utf-8") as file:
            process = file.read().strip()
        end = time.monotonic() + 20  # a signal is delivered when the process next gets a processor
        while alive(process):
            self.assertLess(time.monotonic(), end, f"sleep, process {process}, still runs")
            time.sleep(0.05)


class Links(unittest.TestCase):
    def test_files_and_headings_must_be_there(self):
        write("links/b.md", "# One, two & three\n## Same\n## Same\n")
        write("links/a.md",
              "[b](b.md) [x](b.md#one-two--three) [y](b.md#same-1) [z](https://nowhere.example)\n"
              "[gone](c.md)\n[long\ntext](b.md#four)\n[own](#none)\n"
              "```\n[code](c.md)\n```\n`[code](c.md)`\n")
        code, output = run("links.py", os.path.join(FOLDER, "links"))
        self.assertEqual(code, 1)
        places = [line.split(": ")[0] for line in output.split("\n") if line]
        self.assertEqual(places, ["a.md:2", "a.md:4", "a.md:5"], output)

    def test_a_file_that_a_page_names_must_be_there(self):
        write("names/core/one_thing.h", "")
        write("names/core/tests/one_test.cc", "")
        write("names/README.md",
              "`core/one_thing` `core/one_thing.{h,cc}` `one_test.cc` `core/NAME.h` `runs/out.csv`\n"
              "`core/gone.h`\n`gone.py`\n```\ncore/gone.h\n```\n")
        write("names/core/README.md",
              "| file | concept |\n|---|---|\n| `one_thing` | `anything` |\n| `lost` | b |\n\n"
              "| choice | what |\n|---|---|\n| `lost` | b |\n")
        code, output = run("links.py", os.path.join(FOLDER, "names"))
        self.assertEqual(code, 1)
        self.assertEqual(output.rstrip().split("\n"), [
            "README.md:2: `core/gone.h`: no such file", "README.md:3: `gone.py`: no such file",
            "core/README.md:4: `lost`: no such file"])


TESTS = ["a_fast_test", "other_test"]


class TestNames(unittest.TestCase):
    def test_every_part_of_a_pattern_must_match_a_test(self):
        build = os.path.join(FOLDER, "build")
        write("build/CTestTestfile.cmake", "".join(f"add_test({name} true)\n" for name in TESTS))
        write("build/test_bin/tool", "")
        write("patterns/a.md", "`ctest -R '^(a_fast|other)_test$'` and `ctest -R \"fast|gone\"`\n"
              "`build/release/test_bin/tool` and `test_bin/lost`\n`ninja -C build/tsan tools`\n")
        code, output = run("test_names.py", os.path.join(FOLDER, "patterns"), build)
        self.assertEqual(code, 1)
        self.assertEqual(output.rstrip().split("\n"), [
            "a.md:1: ctest -R 'fast|gone': no test's name matches 'gone'",
            "a.md:2: test_bin/lost: the build does not make it",
            "a.md:3: tools: the build does not make it"])


if __name__ == "__main__":
    unittest.main()
