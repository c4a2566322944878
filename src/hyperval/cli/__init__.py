"""The command line: each command calls one function of the package and passes on its exit code.

Results go to files, data to standard output, messages to standard error.  Exit codes: 0 all passed,
1 a comparison failed, 2 usage or an invalid file, 3 input missing or corrupt, 4 internal error, 5 nothing
was checked, 130 interrupted, 143 terminated.
"""

from hyperval.cli.main import app, keep_caches, main, print_note, run

__all__ = ["app", "keep_caches", "main", "print_note", "run"]
