"""A peer in a process of its own, under another Python: questions and answers are pickled through its pipes."""

import pathlib
import pickle
import subprocess

import numpy as np

ROOT = pathlib.Path(__file__).parents[2]


class Elsewhere:
    """The peer `peer` of `PEERS`, under the interpreter `python`; what it prints goes to the terminal."""

    def __init__(self, python: pathlib.Path, peer: str, clip: np.ndarray, faces: np.ndarray, size: int):
        command = [python, "-W", "ignore", "-m", __package__, peer]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT)
        try:
            self.name = self._ask((np.asarray(clip), np.asarray(faces), size))
        except Exception:
            self.release()
            raise

    def _ask(self, question):
        try:
            pickle.dump(question, self.process.stdin)
            self.process.stdin.flush()
            worked, answer = pickle.load(self.process.stdout)
        except (EOFError, BrokenPipeError):
            raise RuntimeError(f"its process ended with code {self.process.wait()}") from None
        if not worked:
            raise RuntimeError(answer)
        return answer

    def draw(self) -> None:
        self._ask("draw")

    def faces(self) -> np.ndarray:
        """Face id of every pixel, -1 for none, row 0 on top."""
        return self._ask("faces")

    def release(self) -> None:
        self.process.communicate()
