"""Shares of parts are shares of the whole, whoever tells them, and nobody need listen."""

import threading

from shipfp_rs.support.progress import counted, heard_by, part, tell


def test_parts_of_parts_are_told_as_shares_of_the_whole():
    heard = []
    tell("nobody listens", 0.5)
    with heard_by(lambda what, share: heard.append((what, share))):
        tell("first", 0.0)
        with part(0.5, 1.0):
            with part(0.0, 0.5):
                tell("inner", 0.5)
            tell("outer", 1.0)
    tell("nobody listens any more", 0.5)
    assert heard == [("first", 0.0), ("inner", 0.625), ("outer", 1.0)]


def test_steps_of_threads_are_counted():
    heard = []
    with heard_by(lambda what, share: heard.append(share)), part(0.0, 0.5):
        step = counted("reading", 4)
        threads = [threading.Thread(target=step) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert heard == [0.0, 0.125, 0.25, 0.375, 0.5]
