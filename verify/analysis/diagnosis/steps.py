"""Faults that begin in the session: a joint's offset that changes, a base or camera that moves.

    W xi = B b + C_k c + noise,    C_k = C from pair k on, 0 before

B holds what was fitted and stated and the faults that are there besides. With B orthonormal, all
that a fit for each k needs is C'C, B'C and C'(y - B B'y), each a sum over the pairs from k on: one
pass over the session gives chi-squared at every instant.

=========  =================================================================
kind       what begins
=========  =================================================================
step       the offset of a joint changes
others     what moved (base, LED body, camera) did so then, not before
=========  =================================================================
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from verify.analysis.diagnosis.faults import Fault
from verify.analysis.model import JointErrorModel
from verify.core.records import Array, Flags, Index

MIN_PAIRS_BESIDE = 3  # before and after an instant; fewer are outliers
RIVAL_INSTANTS = 16  # of steps that are tried in any case; the likeliest one is sought besides
MOVING_KINDS = ("base_moved", "led_body_slipped", "camera_turned")
MIN_WORTH = 15.0  # of chi-squared beyond Schwarz's, of a change sought before other faults
TOL_RANK = 1e-8  # of a column's square: what others leave of it by rounding


def instants(model: JointErrorModel) -> Index:
    """Pairs with which a fault may begin: enough lie before and after."""
    last = len(model.comparison) - MIN_PAIRS_BESIDE if model.comparison.timed else 0
    return np.arange(MIN_PAIRS_BESIDE, last + 1)


def beginning_faults(model: JointErrorModel, faults: Iterable[Fault]) -> list[Fault]:
    """Those of the dictionary that may begin in the session, as if they began before it."""
    joints = np.flatnonzero(np.linalg.norm(model.joints, axis=0)).tolist()
    shape = np.ones((len(model.comparison), 1))
    steps = [Fault("step", j + 1, "deg", model.joints[:, [j]], shape=shape) for j in joints]
    return [*steps, *(f for f in faults if f.kind in MOVING_KINDS)]


def begun(model: JointErrorModel, fault: Fault, first: int) -> Fault:
    """A fault that begins halfway between pair `first` - 1 and pair `first`."""
    t = model.comparison.t
    late = np.arange(len(t)) >= first
    return replace(
        fault,
        columns=fault.columns * late[model.white.pair, None],
        shape=None if fault.shape is None else fault.shape * late[:, None],
        begin=float(t[first - 1] + t[first]) / 2,
        instants=len(instants(model)),
    )


def stated_steps(model: JointErrorModel, moving: list[Fault]) -> list[Fault]:
    """Steps in the middle, by which detectable sizes are stated; and at others, as rivals."""
    at = instants(model)
    steps = [f for f in moving if f.kind == "step"]
    if not len(at):
        return []
    rivals = np.linspace(0, len(at) - 1, RIVAL_INSTANTS).round().astype(np.int64)
    chosen = dict.fromkeys([len(at) // 2, *rivals.tolist()])
    return [begun(model, f, int(at[k])) for k in chosen for f in steps]


@dataclass(frozen=True)
class StepScan:
    """The likeliest instants of faults that may begin in a session; `kept` (r,): rows to take."""

    model: JointErrorModel
    kept: Flags

    def likeliest(self, moving: list[Fault], found: list[Fault]) -> list[Fault]:
        """The likeliest instants of each of `moving` (`beginning_faults`) beside those of a set.

        Once beside the set without the fault itself; once without anything else of its joint but an
        offset (of a common one: but the same from the beginning), as what is taken for a drift may
        be a step.
        """
        chosen: list[Fault] = []
        at = instants(self.model)
        if not len(at):
            return chosen
        common = self._free([f.columns for f in found])
        for fault in moving:
            others = [f.columns for f in found if f.name != fault.name]
            strange = [f.columns for f in found if not _is_kin(f, fault)]
            for beside in (others, [*strange, fault.columns]):
                plain = len(beside) == len(found) and beside is others
                gain = self._gains(fault.columns, common if plain else self._free(beside))
                chosen.append(begun(self.model, fault, int(at[np.argmax(gain[at])])))
        return chosen

    def strongest(self, moving: list[Fault], found: list[Fault]) -> Fault | None:
        """The change that explains most beside those that were found; None: none is clear.

        A reading between one from before and one from after a change is neither: its pair lies out,
        which shows once the change itself is known.
        """
        at, rows = instants(self.model), int(self.kept.sum())
        basis = self._free([f.columns for f in found])
        best, most = None, MIN_WORTH
        for fault in moving if len(at) else ():
            gain = self._gains(fault.columns, basis)[at]
            change = begun(self.model, fault, int(at[np.argmax(gain)]))
            worth = float(gain.max()) - change.schwarz(rows)
            if worth > most:
                best, most = change, worth
        return best

    @cached_property
    def _fixed(self) -> Array:
        """An orthonormal basis (r + p, m) of all that was fitted and the p stated, held by rows."""
        free, held = self.model.fitted[self.kept], self.model.prior[self.kept]
        penalty = np.zeros((held.shape[1], free.shape[1])), np.eye(held.shape[1])
        return _orthonormal(np.block([[free, held], [*penalty]]))

    def _free(self, columns: list[Array]) -> Array:
        """An orthonormal basis (r, m) of columns and all that was fitted, stated ones held."""
        fixed, rows = self._fixed, int(self.kept.sum())
        more = np.zeros((len(fixed), sum(c.shape[1] for c in columns)))
        more[:rows] = np.concatenate([self.model.fitted[:, :0], *columns], axis=1)[self.kept]
        more /= np.maximum(np.linalg.norm(more, axis=0), 1e-300)
        for _ in range(2):  # once more, for what rounding left
            more -= fixed @ (fixed.T @ more)
        return np.hstack([fixed, _orthonormal(more, scaled=True)])[:rows]

    def _gains(self, columns: Array, basis: Array) -> Array:
        """What columns (r, p) from each pair on would take off chi-squared beside a basis, (n,)."""
        moving, target = columns[self.kept], self.model.xi[self.kept]
        left = target - basis @ (basis.T @ target)
        whole, shared = self._after(moving, moving), self._after(basis, moving)
        moment = self._after(left[:, None], moving)[:, 0]
        block = whole - np.swapaxes(shared, 1, 2) @ shared
        size = np.sqrt(np.maximum(np.einsum("npp->np", whole), 1e-300))
        block = block / (size[:, :, None] * size[:, None, :])
        value, axis = np.linalg.eigh(block)
        along = np.einsum("npk,np->nk", axis, moment / size)
        gains: Array = np.sum(
            np.divide(along**2, value, out=np.zeros_like(along), where=value > TOL_RANK), axis=1
        )
        return gains

    def _after(self, one: Array, other: Array) -> Array:
        """Products of rows (r, a) with others (r, b), over all pairs from each on, (n, a, b)."""
        pairs, first = np.unique(self.model.white.pair[self.kept], return_index=True)
        sums = np.zeros((len(self.model.white.factors), one.shape[1], other.shape[1]))
        for k in range(other.shape[1]):  # a column at once: all would be most of a session's memory
            sums[pairs, :, k] = np.add.reduceat(one * other[:, k : k + 1], first, axis=0)
        return np.cumsum(sums[::-1], axis=0)[::-1]


def _orthonormal(columns: Array, *, scaled: bool = False) -> Array:
    """An orthonormal basis of columns (r, c); `scaled`: their lengths are those they had left."""
    size = 1.0 if scaled else np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    basis, values, _ = np.linalg.svd(columns / size, full_matrices=False)
    known = values > TOL_RANK * (1.0 if scaled else values.max(initial=0.0))
    return np.asarray(basis[:, known])


def _is_kin(one: Fault, other: Fault) -> bool:
    """Faults of the same joint; of common ones, of the same kind."""
    return one.joint == other.joint and (one.joint is not None or one.kind == other.kind)
