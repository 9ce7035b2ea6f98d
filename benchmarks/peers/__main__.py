"""The other end of `Elsewhere`: `python -m benchmarks.peers NAME` answers pickled questions about one peer."""

import pickle
import sys

from . import PEERS


def serve(kind: type, questions, answers) -> None:
    """Answer until no more is asked: with the peer's name first, then with what the method asked for returns."""
    peer = None
    while True:
        try:
            question = pickle.load(questions)
        except EOFError:
            return
        try:
            if peer is None:
                peer = kind(*question)
                answer = True, peer.name
            else:
                answer = True, getattr(peer, question)()
        except Exception as error:
            answer = False, str(error)
        pickle.dump(answer, answers)
        answers.flush()


if __name__ == "__main__":
    # Whatever the peer prints must not come between the answers.
    pipe, sys.stdout = sys.stdout.buffer, sys.stderr
    serve(PEERS[sys.argv[1]], sys.stdin.buffer, pipe)
