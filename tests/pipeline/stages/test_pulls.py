"""Pulls in children: side by side, kept for the next, named when they fail, ended when asked."""

import sys
import time
from pathlib import Path

import pytest

from pipeline.scene.scene import MaterialParameters, TensileScene
from pipeline.stages import pulls
from pipeline.stages.pulls import Crew, PullQueue, TensileStageError, run_jobs
from pipeline.stages.strength import LOG_FILE, TensileJob
from tests.pipeline.stages import pretending

PRETENDING = pretending.__name__


@pytest.fixture(params=["kept", "alone"])
def way(request, monkeypatch):
    """Children that only pretend to pull: kept, or each started for one job as mpirun is."""
    monkeypatch.setattr(pulls, "_MODULE", PRETENDING)
    if request.param == "alone":
        command = [sys.executable, "-m", PRETENDING]
        monkeypatch.setattr(pulls, "_launcher", lambda ranks: command)
    return request.param


def job(out: Path) -> TensileJob:
    out.mkdir(parents=True)
    material = MaterialParameters(43e9, 0.3, 130e6, 120e6, 10.0)
    return TensileJob(str(out), str(out), str(out), material, TensileScene("P1-Fbar"))


def test_a_job_survives_its_file(tmp_path):
    written = job(tmp_path / "a")
    assert TensileJob.read(written.write()) == written


def test_children_that_pretend_write_the_log_of_those_that_pull():
    assert pretending.LOG_FILE == LOG_FILE


def test_jobs_run_side_by_side_up_to_the_number_asked_for(tmp_path, way):
    jobs = {str(n): job(tmp_path / str(n)) for n in range(4)}
    running, most, done = set(), [], []

    def started(key):
        running.add(key)
        most.append(len(running))

    def finished(key, seconds):
        running.discard(key)
        done.append(key)
        assert seconds >= 0.3

    run_jobs(jobs, workers=2, started=started, finished=finished)
    assert max(most) == 2
    assert sorted(done) == sorted(jobs)
    children = {(tmp_path / name / "by").read_text() for name in jobs}
    assert len(children) == (2 if way == "kept" else 4)


@pytest.mark.parametrize(("name", "said"), [("bad", "no pivot"), ("deaf", "not a word was heard")])
def test_a_failed_job_is_named_with_its_log_and_the_others_finish(tmp_path, way, name, said):
    jobs = {each: job(tmp_path / each) for each in ("good", name)}
    done = []
    with pytest.raises(
        TensileStageError, match=rf"{name} ended with exit status 1 \({said}; log: "
    ):
        run_jobs(jobs, workers=2, finished=lambda key, seconds: done.append(key))
    assert done == ["good"]


def test_children_end_with_an_interrupted_run(tmp_path, way):
    hanging = job(tmp_path / "hanging")
    note = tmp_path / "hanging" / "pid"

    def interrupt(key, fraction):
        if note.exists() and note.read_text():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs({"a": hanging}, advanced=interrupt)
    status = Path("/proc", note.read_text(), "stat")
    assert not status.exists() or " Z " in status.read_text()


def test_a_crew_is_kept_from_one_call_to_the_next_and_a_failure_costs_one_child(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(pulls, "_MODULE", PRETENDING)
    with Crew(1) as crew:
        for name in ("a", "b"):
            run_jobs({name: job(tmp_path / name)}, crew=crew)
        with pytest.raises(TensileStageError, match="bad ended"):
            run_jobs({"bad": job(tmp_path / "bad")}, crew=crew)
        run_jobs({"c": job(tmp_path / "c")}, crew=crew)
    children = [(tmp_path / name / "by").read_text() for name in "abc"]
    assert children[0] == children[1] != children[2]
    for number in children:
        assert not Path("/proc", number).exists()


def test_a_child_that_was_ending_when_it_was_asked_has_done_nothing(tmp_path, monkeypatch):
    """Exit status 0 is no answer: another child does the test, or it failed where it had begun."""
    monkeypatch.setattr(pulls, "_MODULE", PRETENDING)
    done = []
    with pytest.raises(TensileStageError, match="mute ended with exit status 1"):
        run_jobs(
            {name: job(tmp_path / name) for name in ("late", "mute")},
            finished=lambda key, seconds: done.append(key),
        )
    assert done == ["late"]
    first, second = ((tmp_path / "late" / name).read_text() for name in ("before", "by"))
    assert first != second


@pytest.mark.parametrize("element", ["P2", "none"])
def test_a_child_that_compiles_ahead_then_pulls_and_its_failure_costs_no_test(
    tmp_path, monkeypatch, element
):
    monkeypatch.setattr(pulls, "_MODULE", PRETENDING)
    with Crew(2) as crew:
        crew.prepare([element, element])
        first = crew._preparing.process.pid
        run_jobs({name: job(tmp_path / name) for name in "ab"}, workers=2, crew=crew)
    children = {int((tmp_path / name / "by").read_text()) for name in "ab"}
    assert len(children) == 2 and (first in children) == (element == "P2")
    with Crew(1) as crew:
        crew.prepare([element])
        left = crew._preparing.process
    assert left.poll() is not None


def test_the_longest_come_first_and_equal_ones_in_their_order(tmp_path, way):
    begun = []
    queue = PullQueue(started=begun.append)
    queue.add({name: job(tmp_path / name) for name in "ab"}, {"a": 1.0, "b": 1.0})
    queue.add({name: job(tmp_path / name) for name in "cde"}, {"c": 2.0, "d": 0.5, "e": 1.0})
    queue.finish()
    assert begun == ["c", "a", "b", "e", "d"]


def test_tests_are_done_beside_other_work_and_what_is_left_after_it(tmp_path, way):
    done, during = [], []
    queue = PullQueue(workers=2, finished=lambda key, seconds: done.append(key))
    with queue.meanwhile():
        queue.add({name: job(tmp_path / name) for name in "abcd"})
        time.sleep(0.3)
        assert done == []  # nobody has said that there is room
        queue.at_once = 1
        while len(done) < 2:
            time.sleep(0.05)
            during.append(len(queue._running))
    assert max(during) == 1 and done[:2] == ["a", "b"] and sorted(done) == ["a", "b", "c", "d"]


def test_work_that_fails_ends_the_tests_beside_it(tmp_path, way):
    note = tmp_path / "hanging" / "pid"
    queue = PullQueue()
    with pytest.raises(ValueError, match="no steel"), queue.meanwhile():
        queue.at_once = 1
        queue.add({"a": job(tmp_path / "hanging")})
        while not (note.exists() and note.read_text()):
            time.sleep(0.05)
        raise ValueError("no steel")
    status = Path("/proc", note.read_text(), "stat")
    assert not status.exists() or " Z " in status.read_text()


def test_a_test_that_fails_beside_other_work_is_named_after_it(tmp_path, way):
    queue, done = PullQueue(), []
    with pytest.raises(TensileStageError, match="bad ended with exit status 1"), queue.meanwhile():
        queue.at_once = 1
        queue.add({name: job(tmp_path / name) for name in ("bad", "never")})
        while not queue._failures:
            time.sleep(0.05)
        done.append("the march")
    assert done == ["the march"]
    assert not (tmp_path / "never" / "by").exists()


def test_a_crew_keeps_no_child_that_ends_with_the_thread(tmp_path, monkeypatch):
    monkeypatch.setattr(pulls, "_MODULE", PRETENDING)
    with Crew(2) as crew:
        crew.prepare(["P2"])
        first = crew._preparing
        queue = PullQueue(workers=2, crew=crew)
        with queue.meanwhile():
            queue.at_once = 2
            queue.add({name: job(tmp_path / name) for name in "ab"})
        assert crew.idle == [first] and first.alive()
        children = {int((tmp_path / name / "by").read_text()) for name in "ab"}
        assert len(children) == 2 and first.process.pid in children


def test_a_test_that_cannot_be_done_leaves_its_reason_in_the_log(tmp_path):
    """A real child, asked for a test without a mesh."""
    wrong = job(tmp_path / "a")
    with pytest.raises(TensileStageError, match=r"a ended with exit status 1 \(.*mesh"):
        run_jobs({"a": wrong})
    assert "Traceback" in (tmp_path / "a" / "tensile.log").read_text()


def test_a_missing_mpirun_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="mpirun was not found.*--np 2"):
        run_jobs({"a": job(tmp_path / "a")}, ranks=2)
