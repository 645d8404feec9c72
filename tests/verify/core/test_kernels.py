"""Truth: numpy and scipy on the same numbers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from tests.support.kernels import covariance_of, factor, invert, solve, solve_each
from verify.core.kernels.entries import rotation_vectors
from verify.core.records import Array
from verify.measurement.kernels.entries import LEVER, move_pose

UNITS = np.repeat([LEVER, 1.0], 3)


def information(rng: np.random.Generator, rows: int) -> Array:
    """What so many coordinates of a tenth of a pixel say of a pose."""
    design = rng.normal(0.0, 1e3, (rows, 6)) / UNITS
    return design.T @ design * 100.0


@pytest.mark.parametrize("size", [1, 3, 8, 16])
def test_cholesky_solves_and_inverts(size: int) -> None:
    rng = np.random.default_rng(size)
    square = rng.normal(size=(size, 2 * size))
    matrix, right = square @ square.T, rng.normal(size=size)
    root, inverse, x = np.zeros((size, size)), np.empty((size, size)), right.copy()
    assert factor(matrix, 0.0, root)
    assert_allclose(np.tril(root), np.linalg.cholesky(matrix), rtol=1e-12, atol=1e-12)
    solve(root, x)
    assert_allclose(x, np.linalg.solve(matrix, right), rtol=1e-9)
    several = rng.normal(size=(size, 5))
    found = several.copy()
    solve_each(root, found)
    assert_allclose(found, np.linalg.solve(matrix, several), rtol=1e-9)
    invert(root, inverse)
    assert_allclose(inverse, np.linalg.inv(matrix), rtol=1e-9, atol=1e-12)
    least = np.linalg.eigvalsh(matrix)[0]
    assert factor(matrix, 0.999 * least, root)
    assert not factor(matrix, 1.001 * least, root)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.1])
def test_a_pose_moves_by_the_exponential_of_its_step(angle: float) -> None:
    rng = np.random.default_rng(1)
    axis = rng.normal(size=3)
    step = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=2).as_matrix(), [0.1, -0.2, 0.7]
    moved = pose.copy()
    move_pose(moved, step)
    turned = Rotation.from_rotvec(step[3:]).as_matrix() @ pose[:3, :3]
    assert_allclose(moved[:3, :3], turned, rtol=0, atol=1e-15)
    assert_allclose(moved[:, 3], [*(pose[:3, 3] + step[:3]), 1.0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("rows", [16, 6, 5, 3])
def test_what_spots_do_not_determine_is_left_out_of_the_covariance(rows: int) -> None:
    known_information = information(np.random.default_rng(rows), rows)
    covariance, vectors = np.empty((6, 6)), np.empty((6, 6))
    known = np.empty(6, dtype=np.bool_)
    covariance_of(known_information, covariance, vectors, known)
    assert known.sum() == min(rows, 6)
    scaled = known_information * np.outer(UNITS, UNITS)
    truth = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True)
    assert_allclose(covariance / np.outer(UNITS, UNITS), truth, rtol=1e-7, atol=1e-12 * truth.max())
    if rows < 6:
        hidden, found = null_space(scaled, rcond=1e-10), vectors[:, ~known]
        assert_allclose(found @ found.T, hidden @ hidden.T, atol=1e-9)


def test_rotation_vectors_are_scipys_up_to_half_a_turn() -> None:
    rng = np.random.default_rng(7)
    axes = rng.normal(size=(600, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.concatenate(
        [[0.0], 10.0 ** rng.uniform(-12, 0.4, 299), np.pi - 10.0 ** rng.uniform(-7, 0, 300)]
    )
    vectors = axes * angles[:, None]
    found = np.empty_like(vectors)
    rotation_vectors(Rotation.from_rotvec(vectors).as_matrix(), found)
    assert_allclose(found, vectors, rtol=1e-7, atol=1e-15)
    turns = np.array([np.diag(row) for row in 2 * np.eye(3) - 1])  # half a turn about each axis
    rotation_vectors(turns, found[:3])
    assert_allclose(np.abs(found[:3]), np.pi * np.eye(3), atol=1e-15)
