"""What is said of a plugin's process that ended badly."""

import subprocess
import sys
import tempfile

import pytest

from runtime.crew import Process


def last_words(code: str) -> str:
    with tempfile.TemporaryFile() as errors:
        popen = subprocess.Popen([sys.executable, "-c", code], stderr=errors, text=True)
        popen.wait()
        return Process("arm", popen, errors).last_words


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import sys; sys.exit('no connection')", "no connection"),
        ("import sys; sys.exit(3)", "ended with code 3"),
        ("import os; os.kill(os.getpid(), 9)", "was killed by SIGKILL"),
        (
            "import faulthandler, os, sys; faulthandler.enable(); print('reconnecting', file=sys.stderr, flush=True)\n"
            "os.abort()",
            "crashed (Aborted) after: reconnecting",
        ),
        ("import faulthandler; faulthandler.enable(); faulthandler._sigsegv()", "crashed (Segmentation fault)"),
    ],
)
def test_the_last_words_say_how_a_process_ended(code: str, words: str) -> None:
    assert last_words(code) == words
