"""Exit codes, for scripts."""

OK = 0
USAGE = 2  # the command line is wrong, or an output is there already
BAD_INPUT = 3  # a file is missing, damaged, or holds nothing usable
REMOTE = 4  # the server refused, is away, or its job ended without a result
FAILED = 6  # the computation or the writing failed
INTERRUPTED = 130  # Ctrl-C

EXPLAINED = """\
exit codes:
  0    done
  2    wrong usage: an unknown option or value, or the output exists (see --force)
  3    bad input: a file is missing, damaged, or holds nothing usable
  4    the server refused, is away, or its job ended without a result
  6    failed: the fit, the extraction or the writing did not succeed
  130  interrupted by Ctrl-C; 143 by SIGTERM
"""


class UsageError(Exception):
    """The command line asks for something that cannot be done; the message says what instead."""


class OutputError(Exception):
    """The machine could not do it, although the command was right; the message says why."""


class RemoteError(Exception):
    """The server could not or would not; the message says why."""
