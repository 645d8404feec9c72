"""`verify run` on the sample sessions as a user runs it: messages, files, exit status."""

import json
import os
import pydoc
import re
import shutil
import subprocess
import sys
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import pandas as pd
import pytest

import verify as verify_package
from reports.document.formatting import with_uncertainty
from tests.support.command import SAMPLES, Outcome, Run, read_summary, replayed, run, verify
from tests.support.reports.page import Page
from verify import InputError, Results, Setup, analyse, measure, open_results, open_session
from verify.io.series import ALARM_COLUMNS

FAULTY, HEALTHY, QUARTER = "multi_joint_fault_6r", "multi_joint_rv_3sd", "quarter_circle_6r"
WRITTEN = {"report.html", "report.pdf", "summary.json", "frames.csv", "results"}
Word = Literal["conform", "nonconform", "undecided"] | None


FIGURE = float | None


def table(name: str, keys: str = "", /, **more: Any) -> type[msgspec.Struct]:
    """A JSON object whose keys are figures, and `more` of other types."""
    return msgspec.defstruct(name, [*((key, FIGURE) for key in keys.split()), *more.items()])


FLANGE = "rms_error_{0} max_error_{0} expanded_uncertainty_{0} tolerance_{0}"
JOINT = """mean_error_deg plain_mean_error_deg rms_error_deg max_abs_error_deg
    standard_uncertainty_deg
    expanded_uncertainty_deg coverage_factor worst_error_deg worst_error_standard_uncertainty_deg
    tolerance_deg conformance_probability visible_fraction visible_fraction_since_registration
    minimum_detectable_error_deg minimum_separable_error_deg"""
CAUSE = "value standard_uncertainty expanded_uncertainty"
PLACED = {"conformance_probability": FIGURE, "verdict": Word}
# summary.json, format 1: every key that other programs may rely on, with its type
Summary = table(
    "Summary",
    format=Literal[1],
    tool=table("Tool", name=Literal["verify"], version=str),
    session=table("Recorded", path=str, robot=str, description=str, started=str | None),
    pairs=table("Pairs", recorded=int, measured=int, rejected=dict[str, int]),
    clock=table("Clock", "encoder_offset_s standard_uncertainty_s", source=str),
    verdict=Word,
    decision_rule=str,
    joints=list[table("Joint", JOINT, joint=int, verdict=Word)],
    joint_error_correlation=list[list[FIGURE]],
    position=table("Position", FLANGE.format("mm"), **PLACED),
    orientation=table("Orientation", FLANGE.format("deg"), **PLACED),
    diagnosis=list[table("Cause", CAUSE, joint=int | None, kind=str, unit=str, explains=float)],
    budget=table("Budget", uncounted=list[str]),
    inputs=dict[str, str],
    warnings=list[str],
)
COLUMNS = [
    *("frame", "t_s", "status", "leds_seen", "known_dof", "reprojection_rms_px"),
    *("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"),
    *("x_encoder_mm", "y_encoder_mm", "z_encoder_mm"),
    *("rx_encoder_deg", "ry_encoder_deg", "rz_encoder_deg"),
    *(
        f"q{joint}_{suffix}"
        for suffix in ("measured_deg", "encoder_deg", "error_deg", "u_deg", "error_u_deg")
        for joint in range(1, 7)
    ),
    *("position_error_mm", "orientation_error_deg", "ambiguous_joints"),
]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(SAMPLES / FAULTY, tmp_path_factory.mktemp("faulty") / "out")


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(SAMPLES / HEALTHY, tmp_path_factory.mktemp("healthy") / "out", "--quiet")


@pytest.fixture(scope="module")
def cut_short(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An encoder log that ends early, no tolerance, and a name that shells and codecs dislike."""
    folder = tmp_path_factory.mktemp("names") / "Prüfung № 3 – ñandú" / "a b"
    shutil.copytree(SAMPLES / QUARTER, folder)
    log = (folder / "encoders.csv").read_text().splitlines()
    kept = [line for line in log[1:] if float(line.split(",")[0]) < 11.0]
    (folder / "encoders.csv").write_text("\n".join([log[0], *kept, ""]))
    facts = (folder / "session.toml").read_text().partition("[tolerance]")[0]
    (folder / "session.toml").write_text(facts)
    return run(folder, folder.parent / "out put")


@pytest.fixture
def without_pdf(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare the seconds that a PDF takes where it is not what the test is about."""
    monkeypatch.setattr("reports.format.pdf.pages", lambda *_: b"%PDF-")


def files(folder: Path) -> dict[str, bytes]:
    inside = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in inside}


def test_the_output_folder_holds_exactly_the_documented_files(faulty: Run) -> None:
    assert {path.name for path in faulty.out.iterdir()} == WRITTEN
    assert [path.name for path in faulty.out.parent.iterdir()] == ["out"]
    assert (faulty.out / "report.html").read_bytes().startswith(b"<!doctype html>")
    assert (faulty.out / "report.pdf").read_bytes().startswith(b"%PDF-")
    assert str(faulty.out / "report.html") in faulty.outcome.out  # it says where the report is


def test_the_summary_has_every_promised_key_with_its_type(
    faulty: Run, healthy: Run, cut_short: Run
) -> None:
    for one in (faulty, healthy, cut_short):
        text = (one.out / "summary.json").read_bytes()
        msgspec.json.decode(text, type=Summary)
        assert one.joints("joint").tolist() == [1, 2, 3, 4, 5, 6]
        assert np.shape(one.summary["joint_error_correlation"]) == (6, 6)
        inputs = one.summary["inputs"]
        assert set(inputs) >= {"rig.toml", "marker.toml", "encoders.csv", "left.mkv"}
        assert all(value.startswith("sha256:") for value in inputs.values())
        assert b"NaN" not in text
        assert b"Infinity" not in text


def test_the_frames_table_has_its_columns_in_order_and_a_row_a_pair(
    faulty: Run, cut_short: Run
) -> None:
    for one in (faulty, cut_short):
        header, *rows = (one.out / "frames.csv").read_text(encoding="utf-8").splitlines()
        assert header.split(",") == COLUMNS
        recorded = len((one.folder / "frames.csv").read_text().splitlines()) - 1
        assert len(rows) == recorded == one.summary["pairs"]["recorded"]
        assert one.frames["frame"].tolist() == list(range(recorded))


def test_a_pair_without_a_reading_keeps_its_row_with_empty_figures(cut_short: Run) -> None:
    frames, pairs = cut_short.frames, cut_short.summary["pairs"]
    lost = frames[frames["status"] != "measured"]
    assert set(lost["status"]) == {"no_encoder"}
    assert pairs["rejected"] == {"no_encoder": len(lost)}
    assert pairs["measured"] == len(frames) - len(lost) > 20
    figures = [c for c in COLUMNS if c[0] == "q" or c.endswith(("_mm", "_error_deg"))]
    assert lost[figures].isna().all(axis=None)
    assert not frames[frames["status"] == "measured"][figures].isna().any(axis=None)


def test_figures_of_the_table_and_of_the_summary_agree(faulty: Run) -> None:
    frames = faulty.frames
    for joint in faulty.summary["joints"]:
        error = frames[f"q{joint['joint']}_error_deg"]
        reading = frames[f"q{joint['joint']}_encoder_deg"]
        assert np.allclose(reading - frames[f"q{joint['joint']}_measured_deg"], error, atol=2e-6)
        assert joint["plain_mean_error_deg"] == pytest.approx(error.mean(), abs=1e-6)
        assert joint["max_abs_error_deg"] == pytest.approx(error.abs().max(), abs=1e-6)
        assert joint["rms_error_deg"] == pytest.approx(np.sqrt((error**2).mean()), abs=1e-6)


def test_one_number_for_one_thing(faulty: Run) -> None:
    """The mean of the resolved error: in summary.json, table, terminal and headline."""
    page = (faulty.out / "report.html").read_text(encoding="utf-8")
    page = page.replace("\N{NO-BREAK SPACE}", " ")
    resolved = pd.read_parquet(faulty.out / "results" / "resolved.parquet")
    for joint in faulty.summary["joints"]:
        mean, expanded = joint["mean_error_deg"], joint["expanded_uncertainty_deg"]
        curve = resolved[f"q{joint['joint']}_resolved_deg"]
        assert mean == pytest.approx(curve.mean(), abs=1e-9)
        assert abs(joint["worst_error_deg"]) == pytest.approx(curve.abs().max(), abs=1e-9)
        line = f"joint {joint['joint']}: {with_uncertainty(mean, expanded, '°')}"
        assert line in faulty.outcome.out
        assert with_uncertainty(mean, expanded) in page
    (cause,), faulted = faulty.summary["diagnosis"], faulty.summary["joints"][1]
    assert cause["value"] == faulted["mean_error_deg"]
    assert cause["expanded_uncertainty"] == faulted["expanded_uncertainty_deg"]
    stated = with_uncertainty(cause["value"], cause["expanded_uncertainty"], "°", signed=False)
    for text in (page, faulty.outcome.out):
        assert f"Joint 2 reads {stated} (k = 2) too high" in text


def test_the_fault_of_the_sample_is_named_and_its_tolerance_is_the_sessions(faulty: Run) -> None:
    assert faulty.outcome.status == 1
    summary = faulty.summary
    assert [joint["tolerance_deg"] for joint in summary["joints"]] == pytest.approx([0.2] * 6)
    assert summary["position"]["tolerance_mm"] == pytest.approx(1.0)
    assert summary["orientation"]["tolerance_deg"] == pytest.approx(0.3)
    (cause,) = summary["diagnosis"]
    assert (cause["joint"], cause["kind"]) == (2, "offset")
    assert abs(cause["value"] - 0.35) <= 1.5 * cause["expanded_uncertainty"]
    assert summary["joints"][1]["verdict"] == summary["verdict"] == "nonconform"


def test_a_healthy_robot_conforms_and_quiet_prints_nothing(healthy: Run) -> None:
    assert healthy.outcome == Outcome(0, "", "")
    assert healthy.summary["verdict"] == "conform"
    assert healthy.summary["diagnosis"] == []


@pytest.mark.usefixtures("without_pdf")
def test_a_tolerance_finer_than_the_measurement_is_undecided(healthy: Run, tmp_path: Path) -> None:
    with replayed(healthy.measurements):
        outcome = verify("run", healthy.folder, "-o", tmp_path / "out", "--tolerance", "0.02")
    assert outcome.status == 3
    summary = read_summary(tmp_path / "out")
    assert summary["verdict"] == "undecided"
    assert not any(joint["verdict"] == "conform" for joint in summary["joints"])


@pytest.mark.usefixtures("without_pdf")
def test_a_tolerance_a_joint_is_taken_joint_by_joint(faulty: Run, tmp_path: Path) -> None:
    wide = "0.2,0.6,0.2,0.25,0.2,0.3"
    with replayed(faulty.measurements):
        outcome = verify("run", faulty.folder, "-o", tmp_path / "out", "--tolerance", wide,
                         "--position-tolerance=9", "--orientation-tolerance=5")  # fmt: skip
    assert outcome.status == 0
    summary = read_summary(tmp_path / "out")
    given = [joint["tolerance_deg"] for joint in summary["joints"]]
    assert given == pytest.approx([0.2, 0.6, 0.2, 0.25, 0.2, 0.3])
    assert {joint["verdict"] for joint in summary["joints"]} == {"conform"}
    assert summary["position"]["tolerance_mm"] == pytest.approx(9.0)


def test_the_same_session_gives_the_same_bytes_and_json_is_all_that_json_prints(
    faulty: Run, tmp_path: Path
) -> None:
    again = run(faulty.folder, tmp_path / "again", "--json")
    assert again.outcome.status == faulty.outcome.status
    assert again.outcome.err == ""
    message = [json.loads(line) for line in again.outcome.out.splitlines()]
    assert all(isinstance(line, dict) for line in message)
    assert message[-1]["type"] == "result"
    assert message[-1]["summary"] == faulty.summary
    assert files(again.out) == files(faulty.out)


def test_reports_built_again_are_the_same_bytes(faulty: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(faulty.out, out)
    for name in ("report.html", "report.pdf"):
        (out / name).unlink()
    (out / "notes.txt").write_text("mine")
    assert verify("report", out).status == 0
    assert files(out) == files(faulty.out) | {"notes.txt": b"mine"}


def test_without_a_tolerance_and_at_an_unusual_path_there_is_no_verdict_and_status_0(
    cut_short: Run,
) -> None:
    assert cut_short.outcome.status == 0
    assert {path.name for path in cut_short.out.iterdir()} == WRITTEN
    summary = cut_short.summary
    assert summary["session"]["path"].endswith("a b")
    judged = [summary, *summary["joints"], summary["position"], summary["orientation"]]
    assert {part["verdict"] for part in judged} == {None}
    assert {joint["tolerance_deg"] for joint in summary["joints"]} == {None}
    assert {joint["conformance_probability"] for joint in summary["joints"]} == {None}


@pytest.mark.usefixtures("without_pdf")
def test_folders_whose_names_are_not_utf_8_are_read_and_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"lat\xfcn")
    shutil.copytree(SAMPLES / QUARTER, name)
    done = verify("run", name)
    assert done.status == 0, done.err
    assert read_summary(Path(f"{name}-report"))["session"]["path"] == r"lat\udcfcn"
    assert verify("identify", name, "-o", "identified").status == 0
    assert verify("convert", name, "-o", f"{name}-csv", "--to", "parquet").status == 0
    done = verify("batch", name, "-o", f"{name}-fleet", "--workers", "1")
    assert done.status == 0, done.err


@pytest.mark.usefixtures("without_pdf")
def test_without_out_the_folder_is_named_for_the_session(
    healthy: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with replayed(healthy.measurements):
        assert verify("run", healthy.folder, "--quiet").status == 0
    assert [path.name for path in tmp_path.iterdir()] == [f"{HEALTHY}-report"]
    frames = tmp_path / f"{HEALTHY}-report" / "frames.csv"
    assert frames.read_bytes() == (healthy.out / "frames.csv").read_bytes()


@pytest.fixture(scope="module")
def analysed(faulty: Run) -> Results:
    return analyse(open_session(faulty.folder))


def test_the_library_saves_what_the_command_writes(
    faulty: Run, analysed: Results, tmp_path: Path
) -> None:
    analysed.save(tmp_path / "saved")
    assert files(tmp_path / "saved") == files(faulty.out)
    with pytest.raises(InputError, match="exists and is not empty"):
        analysed.save(tmp_path / "saved")
    opened = open_results(tmp_path / "saved")
    pd.testing.assert_frame_equal(opened.joints, analysed.joints)
    assert str(opened) == str(analysed)
    with pytest.raises(InputError, match=r"no results\.json"):
        open_results(tmp_path)


@pytest.mark.usefixtures("without_pdf")
def test_the_alarms_of_a_watch_are_part_of_its_results(faulty: Run, tmp_path: Path) -> None:
    folder = tmp_path / "watched"
    shutil.copytree(faulty.folder, folder)
    alarm = "1,change,2026-01-15T09:00:03Z,,3.0,,2,,0.35,0.01,joint 2 has changed"
    (folder / "alarms.csv").write_text(f"{','.join(ALARM_COLUMNS)}\n{alarm}\n")
    with replayed(faulty.measurements):
        results = analyse(open_session(folder))
    assert results.table("alarms")["joint"].tolist() == [2]
    assert results.summary["inputs"]["alarms.csv"].startswith("sha256:")
    results.save(tmp_path / "out")
    assert pd.read_csv(tmp_path / "out" / "alarms.csv").equals(pd.read_csv(folder / "alarms.csv"))
    assert open_results(tmp_path / "out").table("alarms")["text"].tolist() == [alarm.split(",")[-1]]


def test_results_in_python_are_those_of_the_summary(faulty: Run, analysed: Results) -> None:
    assert analysed.verdict == faulty.summary["verdict"] == "nonconform"
    assert str(analysed) == faulty.outcome.out.splitlines()[0]
    joints = analysed.joints
    assert list(joints.index) == [1, 2, 3, 4, 5, 6]
    for key in ("mean_error_deg", "expanded_uncertainty_deg", "tolerance_deg"):
        assert np.array_equal(joints[key], faulty.joints(key))
    worst_u = 2 * faulty.joints("worst_error_standard_uncertainty_deg")
    assert np.allclose(joints["worst_error_expanded_uncertainty_deg"], worst_u)
    (cause,) = analysed.causes.to_dict("records")
    assert (cause["kind"], cause["joint"]) == ("offset", 2)
    assert cause["value"] == pytest.approx(0.35, abs=cause["expanded_uncertainty"])  # simulated
    assert cause["remedy"] == f"add −{cause['value']:.4f}° to its reading"


def test_results_show_themselves_and_draw_the_reports_figures(analysed: Results) -> None:
    assert repr(analysed) == f"<Results of {FAULTY}: nonconform, 60 of 60 pairs measured>"
    page = analysed._repr_html_()
    shown = Page(page)  # every element is closed
    assert shown.text[shown.text.index("2") :][:2] == ["2", "+0.3487° ± 0.0033°"]
    assert len(page) < 4000
    assert {"overview", "joint_errors", "path"} <= set(analysed.plots)
    assert [axes.get_ylabel() for axes in analysed.plot().axes] == ["error [°]"]
    with pytest.raises(InputError, match='no figure "nonsense"'):
        analysed.plot("nonsense")


def test_the_library_measures_as_the_command_does(faulty: Run) -> None:
    session = open_session(str(faulty.folder))
    assert repr(session) == f"<Session {FAULTY}: iust_6r, 60 pairs, 257 readings>"
    chain = measure(session.pairs(), Setup(session.rig, session.marker))
    first = list(islice(chain, 3))
    assert re.fullmatch(r"<Measurement of pair 0: measured, 4 LEDs, 0\.\d{3} px>", repr(first[0]))
    assert [m.status for m in first] == ["measured"] * 3
    for one, other in zip(first, faulty.measurements, strict=False):
        # encoders may choose among assignments; they enter no value
        assert np.array_equal(one.pose.rig_T_flange, other.pose.rig_T_flange)


def test_the_package_lists_its_names_and_loads_no_large_library_before_they_are_used() -> None:
    code = "import sys, verify; names = {n for n in dir(verify) if n[0] != '_'};"
    code += "assert names | {'__version__'} == set(verify.__all__);"
    code += "print([m for m in ('cv2', 'pandas', 'scipy') if m in sys.modules])"
    words = [sys.executable, "-c", code]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == "[]\n"
    page = pydoc.plain(pydoc.render_doc(verify_package))
    shown = set(verify_package.__all__) - {"__version__"}  # shown as VERSION
    assert {name for name in shown if name not in page} == set()
    every = set(vars(verify_package)["_MODULES"])
    assert set(verify_package.__all__) == every


@pytest.mark.parametrize("name", ["results", "summary.json"])
def test_what_stands_in_the_way_of_a_result_is_named_before_anything_is_measured(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    obstacle = tmp_path / name
    obstacle.mkdir() if "." in name else obstacle.write_text("mine")
    monkeypatch.setattr("verify.cli.measure.analyse", lambda *_, **__: pytest.fail("measured"))
    ended = verify("run", SAMPLES / HEALTHY, "-o", tmp_path, "--force")
    assert ended.refusal.startswith(f"error: {obstacle}: is a ")
    assert list(tmp_path.iterdir()) == [obstacle]


@pytest.mark.parametrize("place", ["notes.txt", "notes.txt/below", "/proc/verify-report"])
def test_a_place_that_takes_no_results_is_refused_before_anything_is_measured(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    monkeypatch.setattr("verify.cli.measure.analyse", lambda *_, **__: pytest.fail("measured"))
    ended = verify("run", SAMPLES / HEALTHY, "-o", tmp_path / place, "--force")
    assert ended.refusal.startswith(f"error: {tmp_path / place}: ")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
