"""Are the claimed uncertainties true? The random part, by simulated sessions through pixels.

The unit is the session. A cell (arm, joint) is the mean over sessions of the share of pairs whose
±1.96 u holds the true angle: it must lie within 93 to 97 %, with a standard error between
sessions of at most 0.7 %. Near-singular pairs are left out by the tool's own flag.

    python -m tests.bench.coverage [SESSIONS] [SEED] [--classes [CLASS=LEVEL] ...]

With --classes, sessions of every kind instead: 10 and 30 pairs a second, slow and brisk, right
pictures 0 to 40 ms late, FFV1 and MJPEG, two to five LEDs, some hidden, before a dark room or a
bright one with texture. Coverage of a pair's joints and of its errors in every class, and the
joints' rms against that of a carrier that knows the motion between the two pictures: each session
counts alike, as one near a singularity would make up the whole of a class. "room=24 px, 4 DN" takes
sessions of that class alone.
"""

import os
import sys
from collections.abc import Generator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial

import msgspec
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import t as student_t

import robots
from tests.bench.cells import HIGH, LOW, SEEDS, WITHIN, conclude, replicates
from tests.support.leds.images import through_jpeg
from tests.support.leds.truth import led_images
from tests.support.random_scenarios import random_scenario
from tests.support.simulated import InMemory, in_memory
from verify.analysis.session import analyse
from verify.core.records import Array, StereoPair
from verify.core.rig import Rig
from verify.measurement.alignment import AlignedSightings, RawSightings
from verify.measurement.chain import Setup, measure
from verify.simulation.scenario import Occlusion, Scenario
from verify.simulation.world.led_render import Renderer
from verify.simulation.world.motion import RandomStream, generator

ARMS = ("iust_6r", "rv_3sd_melfa")
SESSIONS = 100
PAIRS = 40
STANDARD_ERROR = 0.007
Around = Sequence[RawSightings | None]
KINDS = 120  # sessions with --classes: nine of a class tell too little
MAX_DRAWS = 2000  # of a session of the classes asked for
MAX_RMS_RATIO = 1.1
JPEG_QUALITY = 90  # of a webcam's MJPEG
INSTANT = 1e-4  # s, over which a known motion is straight
ROOM_DN = 50.0  # of a bright room
ROOMS = [f"{grain} px, {depth} DN" for grain in (24, 12, 6) for depth in (4, 15)]


def session_shares(arm: str, seed: int) -> tuple[Array, float, float]:
    """Share of pairs that hold the truth, a joint; share left out as singular; as not measured."""
    rng = np.random.default_rng(seed)
    session = in_memory(random_scenario(rng, arm, leds=int(rng.integers(3, 6)), pairs=PAIRS))
    frames = analyse(session).tables["frames"]
    truth = np.rad2deg(session.truth)
    joints = truth.shape[1]
    measured = frames[[f"q{j + 1}_measured_deg" for j in range(joints)]].to_numpy()
    u = frames[[f"q{j + 1}_u_deg" for j in range(joints)]].to_numpy()
    hit = np.abs(measured - truth) <= WITHIN * u
    seen = (frames["status"] == "measured").to_numpy()
    clear = seen & (frames["ambiguous_joints"] == "").to_numpy()
    shares = hit[clear].mean(axis=0) if clear.any() else np.full(joints, np.nan)
    return shares, 1 - clear.sum() / max(int(seen.sum()), 1), 1 - float(seen.mean())


@dataclass(frozen=True)
class _Kept(InMemory):
    """A session whose pictures stay in memory."""

    kept: list[StereoPair]

    def pairs(self) -> Generator[StereoPair]:
        yield from self.kept


@dataclass(frozen=True)
class Outcome:
    """One session of a kind; n pairs, j joints, rad; nan where no value was given."""

    classes: dict[str, str]
    hits: tuple[Array, Array]  # (n, j) each: within WITHIN u, the measured angles and the errors
    off: tuple[
        Array, Array
    ]  # (n, j) each, measured less true: this chain, one that knows the motion


def drawn_kind(rng: np.random.Generator, arm: str) -> tuple[Scenario, dict[str, str]]:
    """Draw a session and say which classes it is of."""
    rate, brisk = float(rng.choice([10, 30])), bool(rng.random() < 0.5)
    late = float(rng.choice([0.0, 0.004, 0.4 / rate]))
    leds = int(rng.choice([2, 3, 3, 4, 4, 5, 5]))
    scenario = random_scenario(rng, arm, leds=leds, pairs=PAIRS)
    speed = (
        {"slowest_hz": 0.12, "fastest_hz": 0.5}
        if brisk
        else {"slowest_hz": 0.03, "fastest_hz": 0.1}
    )
    recording = {"rate_hz": rate, "skew_s": late, "skew_jitter_s": min(late, 0.0005)}
    hidden = str(rng.choice(["nothing", "an LED", "half an LED"]))
    names = [led.name for led in scenario.marker.led]
    hides = []
    for first in range(4, PAIRS - 6, 9) if hidden != "nothing" else ():
        share = 1.0 if hidden == "an LED" else 0.5
        name, side = str(rng.choice(names)), str(rng.choice(["left", "right"]))
        hides.append(Occlusion(led=name, first=first, last=first + 5, camera=side, share=share))
    changed = msgspec.structs.replace(
        scenario,
        motion=msgspec.structs.replace(scenario.motion, **speed),
        recording=msgspec.structs.replace(scenario.recording, **recording),
        occlusion=hides,
    )
    codec = str(rng.choice(["FFV1", "MJPEG"]))
    room = str(rng.choice(["dark"] * len(ROOMS) + ROOMS))
    skew = "none" if not late else "4 ms" if late == 0.004 else f"{late * 1e3:.0f} ms"
    return changed, {
        "rate": f"{rate:.0f} Hz", "motion": "brisk" if brisk else "slow", "skew": skew,
        "codec": codec, "LEDs": str(leds), "hidden": hidden, "room": room,
    }  # fmt: skip


@dataclass(frozen=True)
class Room(Renderer):
    """A camera before a bright room: texture that is smooth over a grain, with noise as on LEDs."""

    grain_px: float

    @cached_property
    def _room(self) -> Array:
        rng, (width, height) = generator(self.seed, RandomStream.ROOM, self.side), self.image_size
        field = rng.standard_normal((height, 2 * width))  # for turning bases to look round
        field = gaussian_filter(field, self.grain_px / 2, mode="wrap")
        room = self.table.background_dn + self.table.texture_dn * field / field.std()
        return np.asarray(np.maximum(room, 0.0), np.float32)


def before_a_room(session: InMemory, room: str) -> InMemory:
    """A session before a room: texture of a grain (px) and standard deviation (DN)."""
    grain, depth = (float(word.split()[0]) for word in room.split(","))
    played, look = session.simulated, {"background_dn": ROOM_DN, "texture_dn": depth}
    left, right = (
        Room(msgspec.structs.replace(one.table, **look), one.image_size, one.seed, one.side, grain)
        for one in played.renderers
    )
    return replace(session, simulated=replace(played, renderers=(left, right)))


def session_of_a_kind(only: dict[str, str], seed: int) -> Outcome:
    """Measure one session, of the classes `only`, and the same pictures with the motion known."""
    rng = np.random.default_rng(seed)
    arm = str(rng.choice(ARMS))
    drawn = (drawn_kind(rng, arm) for _ in range(MAX_DRAWS))
    scenario, classes = next(kind for kind in drawn if only.items() <= kind[1].items())
    plain = in_memory(scenario)
    if classes["room"] != "dark":
        plain = before_a_room(plain, classes["room"])
    pairs = list(plain.pairs())
    if classes["codec"] == "MJPEG":
        pairs = [
            replace(
                p,
                left=through_jpeg(p.left, JPEG_QUALITY),
                right=through_jpeg(p.right, JPEG_QUALITY),
                lossy=(True, True),
            )
            for p in pairs
        ]
    session = _Kept(**{f.name: getattr(plain, f.name) for f in fields(plain)}, kept=pairs)
    frames = analyse(session).tables["frames"]
    clear = ((frames["status"] == "measured") & (frames["ambiguous_joints"] == "")).to_numpy()
    truth = session.truth
    value = {
        kind: np.deg2rad(frames[[f"q{j + 1}_{kind}_deg" for j in range(6)]].to_numpy(dtype=float))
        for kind in ("measured", "u", "error", "error_u")
    }
    off = np.where(clear[:, None], value["measured"] - truth, np.nan)
    error = np.where(clear[:, None], value["error"], np.nan)
    return Outcome(
        classes,
        tuple(
            np.where(np.isnan(e), np.nan, np.abs(e) <= WITHIN * u)
            for e, u in ((off, value["u"]), (error, value["error_u"]))
        ),
        (off, _known_motion(session)),
    )


def _known_motion(session: _Kept) -> Array:
    """Joints of the same pictures less the true ones, (n, j), where the motion is known."""
    played = session.simulated

    def carry(
        now: RawSightings, _around: Around, t: float, _rig: Rig, **_: object
    ) -> AlignedSightings:
        row = int(np.argmin(np.abs(played.t[:, 0] - t)))
        centre, velocity = now.centre.copy(), np.zeros_like(now.centre)
        for side, own in enumerate(now.sides):
            there, then, soon = (
                led_images(played.world, side, float(moment), played.true_pan[row, side])
                for moment in (t, played.t[row, side], t + INSTANT)
            )
            led = now.led[own]
            centre[own] += (there - then)[led]
            velocity[own] = ((soon - there) / INSTANT)[led]  # predicts the next pair
        lever = np.zeros((len(now), 3))
        return AlignedSightings(now, t, centre, now.covariance, velocity, lever)

    off = np.full_like(session.truth, np.nan)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("verify.measurement.chain.align", carry)
        for m in measure(session.pairs(), Setup(session.rig, session.marker)):
            if m.status == "measured" and m.pose is not None and m.pose.known_dof == 6:
                pose = np.linalg.inv(session.rig.rig_T_base) @ m.pose.rig_T_flange
                near = session.truth[m.frame : m.frame + 1]
                off[m.frame] = robots.nearest(session.arm, pose[None], near)[0][0] - near[0]
    return off


def by_class(count: int, seed: int, only: dict[str, str]) -> int:
    """Print every class; how many fail."""
    outcomes, failed = replicates(partial(session_of_a_kind, only), seed, count), 0
    groups = {("all", ""): outcomes}
    for outcome in outcomes:
        for group in outcome.classes.items():
            groups.setdefault(group, []).append(outcome)
    print(
        f"seed {seed}, {count} sessions of {PAIRS} pairs; rms: against known motion, a session each"
    )
    for (kind, level), chosen in sorted(groups.items()):
        shares = [(np.nanmean(o.hits[0]), np.nanmean(o.hits[1])) for o in chosen if has_joints(o)]
        if not shares:
            print(f"  {kind:7s}{level:12s} no pair gives joints")
            continue
        ratio = float(np.sqrt(np.mean([rms_ratio(o) ** 2 for o in chosen if has_joints(o)])))
        share, freedom = np.mean(shares, axis=0), len(shares) - 1
        error = np.std(shares, axis=0) / np.sqrt(max(freedom, 1))
        # a class fails where its mean is clearly outside; one session has no scatter to tell by
        reach = student_t.ppf(0.975, freedom) * error if freedom else 1.0
        good = np.all((share + reach >= LOW) & (share - reach <= HIGH))
        good = bool(good and ratio <= MAX_RMS_RATIO)
        failed += not good
        q, e = (f"{a:.1%} ± {b:.1%}" for a, b in zip(share, error, strict=True))
        line = f"  {kind:7s}{level:12s}{len(shares):3d}  q {q}  error {e}  rms {ratio:.2f}"
        print(line + "  FAILS" * (not good))
    return failed


def rms_ratio(outcome: Outcome) -> float:
    """A session's rms over that of a carrier that knows the motion; 1 where none is measured."""
    own, known = outcome.off
    both = ~np.isnan(own + known)
    if not both.any():
        return 1.0
    return float(np.sqrt(np.mean(own[both] ** 2) / np.mean(known[both] ** 2)))


def has_joints(outcome: Outcome) -> bool:
    """Whether any pair of a session gives a joint."""
    return bool(np.isfinite(outcome.hits[0]).any() and np.isfinite(outcome.hits[1]).any())


def main(sessions: int, seeds: tuple[int, ...]) -> int:
    """Print every cell; 1 where one fails."""
    failed = 0
    for seed in seeds:
        for arm in ARMS:
            outcomes = replicates(partial(session_shares, arm), seed, sessions)
            shares, left_out, not_measured = map(np.array, zip(*outcomes, strict=True))
            share, count = np.nanmean(shares, axis=0), np.sum(~np.isnan(shares), axis=0)
            error = np.nanstd(shares, axis=0, ddof=1) / np.sqrt(count)
            good = (share >= LOW) & (share <= HIGH) & (error <= STANDARD_ERROR)
            failed += int(np.sum(~good))
            print(f"{arm}, seed {seed}, {sessions} sessions of {PAIRS} pairs; left out as singular "
                  f"{left_out.mean():.1%}, not measured {not_measured.mean():.1%}")  # fmt: skip
            for j in range(len(share)):
                message = "" if good[j] else "  FAILS"
                print(f"  q{j + 1}  {share[j]:.1%} ± {error[j]:.1%}{message}")
    return conclude(failed)


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    only = dict(word.split("=", 1) for word in sys.argv[1:] if "=" in word)
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    chosen = (numbers[1],) if len(numbers) > 1 else SEEDS
    if "--classes" in sys.argv:
        count = numbers[0] if numbers else KINDS
        sys.exit(conclude(sum(by_class(count, seed, only) for seed in chosen)))
    sys.exit(main(numbers[0] if numbers else SESSIONS, chosen))
