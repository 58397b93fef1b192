"""What workers tell of their pieces, and what the one who waits makes of it."""

from contextlib import closing

from pellucid.cluster.news import Listener, News, Teller, Watch
from pellucid.progress import reporting_to, stage_of, steps
from worlds.reporters import Told


def tell(key, work, every=0.0, stage="tiles"):
    """Do work as a worker does, and list its news."""
    sent = []
    with reporting_to(Teller(Listener("topic", stage, every), key, lambda topic, news: sent.append(News(**news)))):
        work()
    return sent


def prepare_and_draw():
    with stage_of("samples", 1, "bodies") as advance:
        for _ in steps("darts", [30, 30], "darts"):
            pass
        advance(1)
    for _ in steps("picture", [25, 75], "paths"):
        for _ in steps("exitance", [7, 7], "points"):
            pass


def test_a_worker_tells_of_its_piece_and_before_that_of_what_it_is_in():
    news = tell("a", prepare_and_draw)
    assert [(n.stage, n.done) for n in news if n.stage != "picture"] == [
        *[("samples", 0), ("darts", 0), ("darts", 30), ("darts", 60), ("samples", 1)]
    ]
    assert {n.done / n.total for n in news if n.stage == "picture"} == {0, 0.25, 1}
    assert len(tell("a", prepare_and_draw, every=60)) == 1


def test_what_workers_tell_is_added_up():
    """Each prepares for itself, which is shown once; their pieces are added up, and one that is begun anew takes nothing back."""
    one, other = tell("a", prepare_and_draw), tell("b", prepare_and_draw)
    with reporting_to(told := Told()), closing(Watch("tiles", ["a", "b"], 2)) as watch:
        for pair in zip(one[:5], other[:5], strict=True):
            for news in pair:
                watch.hear(news)
        assert told.total == {"preparation": 1, "samples": 1, "darts": 60} and +told.done == {"darts": 60}
        watch.hear(News("a", 7, "picture", "paths", 100, 75))
        assert told.open == ["tiles"] and told.done["tiles"] == 0.75
        watch.hear(other[4])
        watch.hear(News("of a piece that was given up", 7, "picture", "paths", 100, 75))
        watch.begin_again("a", "c")
        watch.hear(News("c", 1, "picture", "paths", 100, 25))
        assert told.done["tiles"] == 0.75
        watch.complete("b")
        watch.complete("c")
    assert +told.done == {"darts": 60, "tiles": 2} and told.total["tiles"] == 2 and told.open == []


def test_of_what_all_wait_for_only_the_steps_are_shown():
    with reporting_to(told := Told()), closing(Watch("scene", ["a", "b"], 1)) as watch:
        assert told.open == ["scene"]
        for news in tell("a", prepare_and_draw, stage="scene")[:3]:
            watch.hear(news)
        assert told.open == ["scene", "darts"] and +told.done == {"darts": 30}
        watch.complete("a")
        assert told.open == ["scene"] and told.done["scene"] == told.total["scene"] == 1
