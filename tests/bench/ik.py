"""Inverse kinematics against other solvers: time and the share of singular poses that are solved.

All solvers take turns within the same run, and medians are compared: the ratios carry over to
another machine, the microseconds do not.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial

import eaik.IK_DH
import numpy as np
import pinocchio
import py_opw_kinematics as opw
from scipy.spatial.transform import RigidTransform

import robots
from robots.transforms import Array, difference
from tests.bench.detection import medians
from tests.bench.goals import Figure, Line
from tests.support.postures import stretched, wrist_on_axis_1

POSES = 4096  # solved in closed form each round
FEW = 64  # solved one by one in each round
ROUNDS = 9
LEAST = {"ours": 100.0}  # %: every singular pose too
REACHED = 1e-6  # m and rad: looser than ours promises, so that nobody fails by a last digit

Solve = Callable[[Array, Array], Iterable[Array]]  # poses, readings -> each pose's answers


def lines() -> Iterator[Line]:
    """Time, then robustness, one line a comparison."""
    for name in robots.names():
        arm = robots.load(name)
        assert isinstance(arm, robots.DhArm)
        solvers = _solvers(arm)
        yield from _times(arm, solvers)
        yield from _shares(arm, solvers)


def _solvers(arm: robots.DhArm) -> dict[str, Solve]:
    solvers: dict[str, Solve] = {
        "ours": lambda poses, readings: robots.inverse(arm, poses, hold=readings).q,
        "pinocchio, damped": lambda poses, readings: _damped(arm, poses, readings),
    }
    other = eaik.IK_DH.DhRobot(arm.alpha, arm.a, arm.d)  # its angles are θ

    def by_eaik(poses: Array, _: Array) -> list[Array]:
        answers = other.IK_batched(poses, num_worker_threads=1)  # ours is one thread too
        return [arm.joint_angles(np.asarray(answer.Q).reshape(-1, 6)) for answer in answers]

    solvers["EAIK"] = by_eaik
    if arm.family == "spherical_wrist":
        theirs = opw_robot(arm)
        solvers["py-opw-kinematics"] = lambda poses, _: (
            theirs.reach(RigidTransform.from_matrix(poses)).joints  # with margins, which cost it
        )
        solvers["py-opw-kinematics, one branch"] = lambda poses, _: theirs.batch_inverse(
            RigidTransform.from_matrix(poses)
        )[:, None]
    return solvers


def opw_robot(arm: robots.DhArm) -> opw.Robot:
    side = int(np.sign(arm.alpha[2]))
    zeros = {1: (0, -90, 90, 0, 0, 0), -1: (0, -90, -90, 0, 0, 180)}[side]  # of θ against OPW's
    model = opw.KinematicModel(
        a1=arm.a[0], a2=side * arm.a[2], b=0, c1=arm.d[0], c2=arm.a[1], c3=arm.d[3], c4=arm.d[5],
        offsets=tuple(np.radians(zeros) - arm.offset),
    )  # fmt: skip
    return opw.Robot(model, degrees=False)


def _damped(arm: robots.DhArm, poses: Array, readings: Array) -> list[Array]:
    """Pinocchio's usual loop: a Jacobian, a damped step, until the pose is met."""
    model = robots.pinocchio_model(arm)
    data, flange = model.createData(), model.getFrameId("flange")
    answers = []
    for pose, q in zip(poses, readings, strict=True):
        target = pinocchio.SE3(pose)
        for _ in range(100):
            pinocchio.framesForwardKinematics(model, data, q)
            apart = data.oMf[flange].actInv(target)
            error = pinocchio.log6(apart).vector
            if np.abs(error).max() < 1e-9:
                break
            moves = pinocchio.computeFrameJacobian(model, data, q, flange)
            moves = -pinocchio.Jlog6(apart.inverse()) @ moves
            damped = moves @ moves.T + 1e-10 * np.eye(6)
            q = q - moves.T @ np.linalg.solve(damped, error)
        answers.append(q[None])
    return answers


def _times(arm: robots.DhArm, solvers: dict[str, Solve]) -> Iterator[Line]:
    random = np.random.default_rng(1)
    q = random.uniform(arm.lower, arm.upper, (POSES, 6))
    poses, readings = robots.forward(arm, q), q + random.normal(0, 0.01, q.shape)
    counts = {name: FEW if name == "pinocchio, damped" else POSES for name in solvers}
    tasks: dict[str, Callable[[], object]] = {
        name: partial(solve, poses[: counts[name]], readings[: counts[name]])
        for name, solve in solvers.items()
    }
    spent = {name: taken / counts[name] for name, taken in medians(tasks, ROUNDS).items()}
    ours = spent["ours"]
    yield Figure(f"{arm}, all branches of {POSES} poses at once, a pose", ours * 1e6, "µs")
    for name, taken in spent.items():
        if name != "ours":
            yield Figure(f"{arm}, ours / {name}", ours / taken)


def _shares(arm: robots.DhArm, solvers: dict[str, Solve]) -> Iterator[Line]:
    kinds = {"random": _random, "next to a singularity": _near, "on a singularity": _on}
    for kind, draw in kinds.items():
        q = draw(arm)
        poses = robots.forward(arm, q)
        readings = q + np.random.default_rng(2).normal(0, 0.01, q.shape)
        for name, solve in solvers.items():
            answers = zip(solve(poses, readings), poses, strict=True)
            solved = [_solved(arm, answer, pose) for answer, pose in answers]
            label = f"{arm}, {kind}, solved by {name}"
            yield Figure(label, 100 * float(np.mean(solved)), "%", least=LEAST.get(name),
                         note=f"of {len(q)}")  # fmt: skip


def _random(arm: robots.DhArm) -> Array:
    return np.random.default_rng(3).uniform(arm.lower, arm.upper, (300, 6))


def _on(arm: robots.DhArm) -> Array:
    theta = arm.theta(_random(arm)[:200])
    theta[:100, 4] = 0.0
    theta[100:, 2] = stretched(arm)
    return np.concatenate([arm.joint_angles(theta), wrist_on_axis_1(arm, 100, 4)])


def _near(arm: robots.DhArm) -> Array:
    away = 10.0 ** np.random.default_rng(5).uniform(-12, -3, (300, 1))
    return _on(arm) + away * np.array([0, 1.0, 1.0, 0, 1.0, 0])


def _solved(arm: robots.DhArm, answers: Array, pose: Array) -> bool:
    answers = answers[np.isfinite(answers).all(axis=-1)]
    if not len(answers):
        return False
    apart = difference(robots.forward(arm, answers), np.broadcast_to(pose, (len(answers), 4, 4)))
    return bool(np.abs(apart).max(axis=-1).min() < REACHED)
