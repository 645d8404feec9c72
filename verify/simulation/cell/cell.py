"""The simulated cell: a world with a clock of its own, seen by cameras, moved by orders."""

import numpy as np

from robots import forward
from robots.transforms import carry, invert
from verify.core.records import Array, StereoPair, rigid_transform
from verify.devices.protocols import EncoderReading, PanReading
from verify.live.page.scene import joint_origins
from verify.simulation.cell.arm import CellArm
from verify.simulation.cell.hand import CellHand
from verify.simulation.cell.render import CellCamera, RenderedArm
from verify.simulation.cell.scene import DUSK_TIME, CellScene, EventKind
from verify.simulation.cell.setup import CellSetup

RATE = 30.0  # Hz, of the cameras
RIGHT_DELAY = 0.004  # s by which the right picture is later
N_SUBSTEPS = 4  # of the world in a camera's period
BOARD_SIZE = (0.05, 0.22)  # m, half its width and its height


class CellWorld:
    """Everything in the cell as it really is."""

    def __init__(self, setup: CellSetup, scene: CellScene) -> None:
        self.setup, self.scene = setup, scene
        self.t = 0.0
        self._rng = np.random.default_rng(scene.seed)
        self._off = self._rng.normal(0.0, scene.hand_error, 3)
        gripper = setup.cell.gripper
        self.arm = CellArm(setup.home, scene.delay)
        self.hand = CellHand(gripper.opening)
        self.held: tuple[int, Array] | None = None  # which cap is in the hand, grip_T_cap
        self.let_go: dict[int, Array] = {}  # where caps lie that were in the hand, base_T_cap
        self._spans: dict[EventKind, tuple[float, float]] = {}  # s, what has happened: from, to
        self._frame = 0
        self._turned = 0.0  # rad, by as much the bases stood elsewhere in the last picture
        self._cameras = [
            CellCamera(camera, setup.rig.rig_T_base, setup.rig.image_size, gripper, setup.marker, n)
            for n, camera in enumerate((setup.rig.left, setup.rig.right), scene.seed * 2)
        ]

    def now(self) -> float:
        """The world's clock, s."""
        return self.t

    def advance(self, dt: float) -> None:
        """Let dt s pass."""
        self.t += dt
        self.hand.advance(dt)
        grip = self.grip()
        self._happen(grip)
        self._grasp(grip)

    def encoders(self) -> EncoderReading:
        """Read the joints."""
        noise = self._rng.normal(0.0, self.scene.encoder_noise, len(self.setup.home))
        return EncoderReading(self.t, self.t, 0.0005, 0, self.arm.q(self.t) + noise)

    def bases(self) -> PanReading:
        """Read how the camera bases stand."""
        rig, turned = self.setup.rig, self._gone(self.t)
        u = [c.pan_standard_uncertainty or 0.0 for c in (rig.left, rig.right)]
        read = np.array([rig.left.pan, rig.right.pan]) + turned + self._rng.normal(0.0, u)
        moving = any(turn.at <= self.t < turn.at + turn.lasts for turn in self.scene.turns)
        return PanReading(self.t, self.t, 0.0005, 0, read, moving)

    def pair(self, pans: tuple[float, float] | None = None) -> StereoPair | None:
        """Take both pictures; None where no camera delivers any more.

        `pans`, rad: what was read of the bases, left and right; None: they stand as the rig says.
        """
        if self.happened("camera_gone"):
            return None
        rig, scene = self.setup.rig, self.scene
        turned = self._gone(self.t)
        if turned != self._turned:
            self._turned = turned
            for camera, stands in zip(self._cameras, (rig.left.pan, rig.right.pan), strict=True):
                camera.turn(stands + turned)
        posed = self._posed()
        pictures = []
        for camera, t in zip(self._cameras, (self.t, self.t + RIGHT_DELAY), strict=True):
            caps = [
                (cap, place)
                for number, cap in enumerate(scene.caps)
                if (place := self.cap(number, t)) is not None
            ]
            board = self._board() if self.happened("hidden") else None
            light = scene.light
            if self.happened("dusk"):
                gone = np.clip((t - self._spans["dusk"][0]) / DUSK_TIME, 0.0, 1.0)
                light = float(light * (1 - 0.5 * gone))
            pictures.append(camera.picture(caps, posed, light, scene.noise, board))
        pan_readings = (rig.left.pan, rig.right.pan) if pans is None else pans
        times = self.t, self.t + RIGHT_DELAY
        pair = StereoPair(self._frame, *times, *pan_readings, pictures[0], pictures[1])
        self._frame += 1
        return pair

    def grip(self) -> Array:
        """Where the grip point really is, base_T_grip (4, 4)."""
        return np.asarray(self._posed().base_T_flange @ self.setup.cell.gripper.flange_T_grip)

    def cap(self, number: int, t: float) -> Array | None:
        """Where a cap is, base_T_cap (4, 4); None where it was taken away."""
        if number == 0 and self.happened("taken") and self.held is None:
            return None
        if self.held is not None and self.held[0] == number:
            return self.grip() @ self.held[1]
        if number in self.let_go:
            return self.let_go[number]
        return rigid_transform(np.eye(3), self.scene.caps[number].place(t))

    def happened(self, what: EventKind) -> bool:
        """Whether something has happened and still lasts."""
        return what in self._spans and self.t < self._spans[what][1]

    def _gone(self, t: float) -> float:
        """By how much both bases have turned since the start, rad."""
        return sum(turn.gone(t) for turn in self.scene.turns)

    def _happen(self, grip: Array) -> None:
        target = self.cap(0, self.t)
        for happening in self.scene.happenings:
            if happening.what in self._spans:
                continue
            if happening.near is None:
                due = self.t >= happening.at
            else:
                away = np.inf if target is None else np.linalg.norm(target[:3, 3] - grip[:3, 3])
                due = bool(away < happening.near)
            if due:
                self._spans[happening.what] = self.t, self.t + happening.lasts

    def _grasp(self, grip: Array) -> None:
        """What stands between the fingers stops them, and goes with them while they hold it."""
        hand = self.hand
        if self.held is not None:
            if not hand.holds:  # it falls straight down, and stands
                number = self.held[0]
                x, y, _ = (grip @ self.held[1])[:3, 3]
                stands = np.array([x, y, self.scene.caps[number].height / 2])
                self.let_go[number] = rigid_transform(np.eye(3), stands)
                self.held, hand.between = None, 0.0
            return
        hand.between = 0.0
        for number, cap in enumerate(self.scene.caps):
            place = self.cap(number, self.t)
            if place is not None and self._between(grip, place, cap.radius):
                hand.between = 2 * cap.radius
                if hand.holds:
                    self.held = (number, invert(grip) @ place)

    def _between(self, grip: Array, place: Array, radius: float) -> bool:
        inside = carry(invert(grip), place[:3, 3])
        build = self.setup.cell.gripper
        aside = float(np.hypot(inside[0], inside[1]))
        reach = -(build.finger_length - build.tips) < inside[2] < build.tips
        return reach and aside + radius <= max(self.hand.opening, 2 * radius) / 2 + 0.01

    def _posed(self) -> RenderedArm:
        q = self.arm.q(self.t)
        if self.scene.joint_errors:
            q = q + np.array(self.scene.joint_errors)
        arm = self.setup.workspace.arm
        flange = forward(arm, q)
        flange[:3, 3] += self._off
        return RenderedArm(joint_origins(arm, q) + self._off, flange, self.hand.opening)

    def _board(self) -> Array:
        """A board between the target and the cameras."""
        target = self.scene.caps[0].place(self.t)
        half, height = BOARD_SIZE
        x, y = target[0] + 0.05, target[1]
        return np.array([[x, y - half * 4, 0], [x, y + half * 4, 0],
                         [x, y + half * 4, height], [x, y - half * 4, height]])  # fmt: skip
