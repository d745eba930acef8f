#!/usr/bin/env python3
"""The installed package's annotations, as a type checker of its users reads them. Run by run_installed.py."""
import subprocess
import sys

sys.exit(subprocess.run([sys.executable, "-m", "mypy", "--ignore-missing-imports", "--no-incremental", "-p", "robostress"],
                        check=False).returncode)
