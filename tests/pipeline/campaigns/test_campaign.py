"""Campaigns: what a file asks for, what one task is, and (slow) engines, deaths, resumption."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.campaigns import campaign as module
from pipeline.campaigns import engines, task
from pipeline.campaigns.campaign import (
    STORE_FOLDER,
    largest_task,
    read_campaign,
    run_campaign,
    stages,
)
from pipeline.campaigns.task import do_task
from pipeline.cli import main
from pipeline.record.machine import child_environment
from pipeline.record.run_folder import RunFolder
from pipeline.stages.strength import CHECKPOINT_FILE
from tests.pipeline.processes import survivors

PIN = """
thread = "none"
spacing = "250um"
horizon = "250um"
radial_margin = "0.5mm"
axial_margin = "0.5mm"
final_strain = 0.02
"""


OPTIONS = 'alloys = ["Mg-5Gd"]\nimmersion = ["8w"]\n[options]\n'


def write(folder: Path, options: str = "", head: str = "", times: str = '"0w", "4w"') -> Path:
    path = folder / "campaign.toml"
    path.write_text(
        f'alloys = ["Mg-5Gd", "Mg-10Gd"]\nimmersion = [{times}]\n{head}\n[options]\n{PIN}{options}'
    )
    return path


def test_every_combination_is_a_scene_and_equal_stages_are_one_task(tmp_path):
    cases = read_campaign(write(tmp_path, 'mesh_size = ["0.6mm", "0.7mm"]\n'))
    assert [(c.alloy, c.options) for c in cases] == [
        (alloy, (("mesh_size", size),))
        for alloy in ("Mg-5Gd", "Mg-10Gd")
        for size in ("0.6mm", "0.7mm")
    ]
    numbers = read_campaign(write(tmp_path, "mesh-size = [0.6e-3, 0.7e-3]\n"))  # SI
    assert [c.scene for c in numbers] == [c.scene for c in cases]
    geometry, corrode, test = stages(cases, tmp_path / "store")
    # two meshes; the march knows no mesh, but one time for the intact solid and two for the scene
    assert (len(geometry), len(corrode), len(test)) == (2, 4, 8)
    assert len({task.key for wave in (geometry, corrode, test) for task in wave}) == 14


def test_samples_share_geometry_and_the_intact_solid(tmp_path, monkeypatch):
    class Two:
        def constants(self, n):
            return {"interface_diffusivity": (n + 1) * 1e-15}

    monkeypatch.setattr(module, "samples_of", lambda scene, alloy, count: Two())
    cases = read_campaign(write(tmp_path, head="samples = 3"))
    assert [(c.alloy, c.sample) for c in cases] == [
        (alloy, n) for alloy in ("Mg-5Gd", "Mg-10Gd") for n in (1, 2, 3)
    ]
    geometry, corrode, test = stages(cases, tmp_path / "store")
    assert (len(geometry), len(corrode), len(test)) == (1, 8, 8)  # 3 samples and 1 intact, 2 alloys


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("alloys = [", "not a valid TOML file"),
        ("metals = []", "metals is not known"),
        ("alloys = []", "alloys is []"),
        ('alloys = ["Mg-5Gd"]', "immersion is None"),
        ('alloys = ["Mg-5Gd"]\nimmersion = ["8w"]\nsamples = -1', "samples is -1"),
        ('alloys = ["Mg-5Gd"]\nimmersion = ["8w"]\nsamples = 5', "has no posterior of Mg-5Gd"),
        ('alloys = ["Mg-5Gd"]\nimmersion = ["8w"]\noptions = 3', "it must be a table"),
        ('alloys = ["Mg-5Gd"]\nimmersion = ["8w"]\n[options]\ncolour = "red"', "key 'colour'"),
        (OPTIONS + 'mesh_szie = "1mm"', "key 'mesh_szie' (did you mean mesh_size?)"),
        (OPTIONS + "spacing = true", "spacing is True; it must be text, a number or a list"),
        ('alloys = ["Mg-5Gd"]\nimmersion = ["8w"]\n[options]\nmesh_size = []', "0 scenes"),
        ('alloys = ["Mg-7Gd"]\nimmersion = ["8w"]', "Mg-7Gd"),
    ],
)
def test_a_campaign_that_cannot_be_is_refused_in_one_sentence(text, words, tmp_path, capsys):
    path, out = tmp_path / "campaign.toml", tmp_path / "out"
    path.write_text(text)
    assert main(["campaign", str(path), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1 and not out.exists()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--engine", "cloud"], "it must be one of local, dask, mpi"),
        (["--workers", "0"], "--workers is 0"),
        (["--scheduler", "tcp://nowhere:1"], "--scheduler goes with --engine dask"),
    ],
)
def test_engines_that_cannot_be_are_refused(more, words, tmp_path, capsys):
    path = write(tmp_path)
    assert main(["campaign", str(path), "--out", str(tmp_path / "out"), *more]) == 2
    assert words in capsys.readouterr().err


def test_a_task_larger_than_a_worker_is_refused_before_anything_is_made(
    tmp_path, monkeypatch, capsys
):
    path, out = write(tmp_path), tmp_path / "out"
    needed, what = largest_task(read_campaign(path))
    assert 1e8 < needed < 2e9 and "a task (" in what
    monkeypatch.setattr(engines, "available_memory", lambda: 2 * needed - 1e6)
    assert main(["campaign", str(path), "--out", str(out), "--workers", "2"]) == 2
    said = capsys.readouterr().err
    assert "and a worker has" in said and "fewer --workers" in said and not out.exists()


def test_a_store_that_another_campaign_holds_is_refused(tmp_path, capsys):
    path, out = write(tmp_path), tmp_path / "out"
    with RunFolder(out.resolve() / STORE_FOLDER).lock():
        assert main(["campaign", str(path), "--out", str(out)]) == 2
    assert "in use by" in capsys.readouterr().err


def test_a_task_that_refuses_is_begun_once_and_costs_its_scenes_only(tmp_path, monkeypatch):
    """One length is impossible; no other scene is lost by it."""
    cases = read_campaign(write(tmp_path, 'length = ["4mm", "3mm"]\n', times='"0w"'))
    begun = []

    def fake(content, threads):
        begun.append((content["stage"], content["alloy"]))
        short = content["scene"]["geometry"]["parameters"]["length"] < 3.5e-3
        return "too short" if short else ""

    monkeypatch.setattr(module, "do_task", fake)
    with ThreadPoolExecutor(1) as executor:
        path, failures = run_campaign(cases, tmp_path, executor)
    assert failures == ["too short"] and ("geometry", "Mg-5Gd") in begun
    rows = path.read_text().splitlines()
    assert len(rows) == 5 and all(row.endswith("failed") for row in rows[1:])


def test_a_task_whose_child_dies_is_begun_three_times_and_the_next_has_a_child(monkeypatch):
    monkeypatch.setattr(task, "_MODULE", "tests.pipeline.record.answering")
    with ThreadPoolExecutor(1) as executor, task.workers_of(executor):
        found = [
            executor.submit(do_task, {"stage": "test", "do": do}).result()
            for do in ("nothing", "nothing", "die", "nothing")
        ]
    assert "test ended with signal SIGKILL" in found[2] and "last words" in found[2]
    children = [re.search("'process': ([0-9]+)", said)[1] for said in found[:2] + found[3:]]
    assert children[0] == children[1] != children[2] and not task._workers


def test_a_test_that_was_killed_begins_anew(tmp_path, monkeypatch):
    """Gone on with from its checkpoint it would end with other last digits."""
    wave = stages(read_campaign(write(tmp_path)), tmp_path / "store")[2][0]
    checkpoint = Path(wave.key) / CHECKPOINT_FILE
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    there = []
    monkeypatch.setattr(
        task.StagedRun, "map", lambda self, *test: there.append(checkpoint.exists())
    )
    monkeypatch.setattr(task.StagedRun, "pull", lambda self, tests: None)
    task.perform(wave.to_json())
    assert there == [False]


def test_children_end_when_a_campaign_is_interrupted(monkeypatch):
    monkeypatch.setattr(task, "_MODULE", "tests.pipeline.record.answering")
    executor = ThreadPoolExecutor(1)
    with pytest.raises(KeyboardInterrupt), task.workers_of(executor):
        executor.submit(do_task, {"stage": "test", "do": "nothing"}).result()
        child = next(iter(task._workers)).process
        tasks = [executor.submit(do_task, {"stage": "test", "do": "sleep"}) for _ in range(3)]
        time.sleep(0.2)
        raise KeyboardInterrupt
    assert child.returncode == -signal.SIGKILL and not task._workers
    assert "SIGKILL" in tasks[0].result() or "stopped" in tasks[0].result()
    assert tasks[2].cancelled()


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """A small campaign by the local engine: its file, folder and rows."""
    folder = tmp_path_factory.mktemp("local")
    path = write(folder, 'mesh_size = "0.8mm"\n')
    assert main(["campaign", str(path), "--out", str(folder / "out"), "--quiet"]) == 0
    return path, folder / "out", (folder / "out" / "campaign.csv").read_bytes()


def stamps(out: Path) -> dict[Path, int]:
    found = (out / STORE_FOLDER).rglob("*.stage.json")
    return {path.relative_to(out): path.stat().st_mtime_ns for path in found}


@pytest.mark.slow
def test_nothing_is_computed_twice(rows, capsys):
    path, out, table = rows
    before = stamps(out)
    assert main(["campaign", str(path), "--out", str(out)]) == 0
    assert stamps(out) == before and (out / "campaign.csv").read_bytes() == table
    assert table.count(b"\n") == 5 and b"failed" not in table


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["dask", "mpi"])
def test_every_engine_gives_the_same_bytes(rows, engine, tmp_path):
    path, _, table = rows
    command = [sys.executable, "-m", "pipeline.cli", "campaign", str(path), "--engine", engine]
    if engine == "dask":
        pytest.importorskip("distributed")
    else:
        python = [sys.executable, "-m", "mpi4py.futures", *command[1:]]
        command = ["mpirun", "--oversubscribe", "-n", "3", *python]
    done = subprocess.run(
        [*command, "--workers", "2", "--out", str(tmp_path)],
        env=child_environment(1, None), capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "campaign.csv").read_bytes() == table


KILLS = 10


@pytest.mark.slow
def test_campaign_and_workers_killed_at_random_moments_go_on_without_repeating_anything(
    rows, tmp_path
):
    """SIGKILL of a campaign, or of one of its workers; a table that is complete begins anew."""
    path, _, table = rows
    draw = random.Random(20)  # never three workers in a row, which would cost a scene
    victims = [draw.choice(["campaign", "worker"]) for _ in range(KILLS)]
    assert {"campaign", "worker"} == set(victims)
    out, kept, campaign, interrupted = tmp_path / "0", {}, None, 0
    while victims:
        mark = f"perilife-kills-{os.getpid()}-{out.name}"
        campaign = campaign or begin(path, out, mark)
        with suppress(subprocess.TimeoutExpired):
            campaign.wait(draw.uniform(0.0, 8.0))
        now = stamps(out) if (out / STORE_FOLDER).exists() else {}
        assert kept.items() <= now.items()
        kept = now
        if campaign.poll() is not None:
            interrupted += check_whole(campaign, out, table)
            out, kept, campaign = tmp_path / str(int(out.name) + 1), {}, None
        elif victims[-1] == "campaign":
            campaign.kill()
            campaign.wait()
            victims.pop()
            campaign = None
            wait_until(lambda mark=mark: not survivors(mark))  # children end with their parent
            kept = stamps(out) if (out / STORE_FOLDER).exists() else {}
        else:
            workers = [pid for pid in survivors(mark) if pid != campaign.pid]
            if workers:
                os.kill(draw.choice(workers), signal.SIGKILL)
                victims.pop()
    campaign = campaign or begin(path, out, f"perilife-kills-{os.getpid()}-{out.name}")
    campaign.wait(600)
    assert kept.items() <= stamps(out).items()
    assert interrupted + check_whole(campaign, out, table) >= 1


def begin(path: Path, out: Path, mark: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "pipeline.cli", "campaign", str(path), "--out", str(out)]
    environment = child_environment(0, None) | {"PERILIFE_TEST_MARK": mark}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def check_whole(campaign: subprocess.Popen, out: Path, table: bytes) -> int:
    """One, for a campaign that ended well with the rows of one that nobody killed."""
    assert campaign.returncode == 0, campaign.stderr.read().decode()[-2000:]
    assert (out / "campaign.csv").read_bytes() == table
    return 1


def wait_until(done, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.05)
