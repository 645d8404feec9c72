"""Run the control loop: two pictures in, one set point out, as far as the state machine allows."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from verify.core.records import Array, StereoPair
from verify.devices.protocols import EncoderReading
from verify.grasping.actuators.protocols import (
    CLOSED_STATES,
    Gripper,
    GripperState,
    GripperStatus,
    MotionRefusedError,
    MoverState,
    MoverStatus,
)
from verify.grasping.control.aim import Aim, LoopCycle
from verify.grasping.control.arm import TOL_SAME_GOAL, DrivenArm
from verify.grasping.control.states import DeviceOrder, GraspEvent, GraspState, StateMachine
from verify.grasping.control.watchdog import Observation, Watchdog
from verify.grasping.planning.workspace import Workspace
from verify.grasping.tracking.target import TargetObservation
from verify.grasping.tracking.track import TargetTracker

UNSELECTED = "no object is selected"
SELECTABLE_STATES = {  # in which another target may be chosen
    GraspState.IDLE, GraspState.SEARCHING, GraspState.TRACKING, GraspState.HOLDING_STALE,
    GraspState.HOLDING_LOST, GraspState.HOLDING_UNREACHABLE, GraspState.HOLDING_OPERATOR,
}  # fmt: skip
AIMING_STATES = frozenset(
    {GraspState.TRACKING, GraspState.FOLLOWING, GraspState.HOLDING_UNREACHABLE}
)


@dataclass(frozen=True, slots=True)
class Actuators:
    """What moves; there is none without the operator's permission."""

    arm: DrivenArm
    gripper: Gripper


class GraspLoop:
    """Tracks, follows, grabs; one `cycle` a pair of pictures.

    Without a tracker there is no target until `look_for` is called; without hands nothing may move,
    and the plan is all there is. `joints` reads the joint angles; None where there is no reading.
    The pictures' times and the devices' are on the clock, s, monotonic, too. `auto`: grab as soon
    as the target stands still.
    """

    def __init__(
        self,
        setup: Workspace,
        tracker: TargetTracker | None,
        aim: Aim,
        hands: Actuators | None,
        joints: Callable[[], EncoderReading | None],
        clock: Callable[[], float],
        *,
        auto: bool = False,
    ) -> None:
        self._setup, self._tracker, self._hands = setup, tracker, hands
        self.may_move = hands is not None  # arm and gripper, with permission to move them
        self._joints, self._clock = joints, clock
        self.aim = aim
        self.machine = StateMachine(self.may_move, clock)
        self._watchdog = Watchdog(
            self.machine, setup.cell.watch, setup.cell.still, auto=auto and self.may_move
        )
        self._acted: GraspState | None = None  # in which state `_act` was last
        self.pictures_t: float | None = None  # s, when the newest pair was taken
        self._tracked_t: float | None = None
        self.joints_t: float | None = None  # s, when the joints were last read
        self.arm: MoverStatus | None = None  # None: there is none, or no status yet
        self._hold_first = False  # the operator's stop came before anything had begun
        self._q: Array | None = None
        self._refused = ""  # what a device refused
        self.awaited = ""  # why it cannot begin; empty: it can
        self._fingers: GripperStatus | None = None

    @property
    def may_choose(self) -> bool:
        """Another target may be chosen: nothing moves, and the hand is up and empty."""
        machine = self.machine
        if machine.state not in SELECTABLE_STATES or machine.low or machine.carrying:
            return False
        return self._hands is None or self._hands.arm.resting

    @property
    def selected(self) -> bool:
        """There is a target to look for."""
        return self._tracker is not None

    @property
    def reason(self) -> str:
        """Why the state is what it is."""
        looks = self.selected or self.machine.state is not GraspState.SEARCHING
        return self.machine.reason if looks else UNSELECTED

    def look_for(self, tracker: TargetTracker | None) -> None:
        """Go after another target from now on; what was known of the last one is forgotten.

        Raises:
            ValueError: not now; see `may_choose`.
        """
        if not self.may_choose:
            raise ValueError(f"no other target while the state is {self.machine.state.value}")
        self._tracker, self._tracked_t = tracker, None
        self.aim.forget()
        self.aim.target, self.aim.unreachable = None, ""
        self.machine.still = self.machine.planned = False

    def start(self) -> None:
        """Take the arm's controls and make the gripper ready, where they may be used."""
        if self._hands is not None:
            self._try(self._hands.arm.mover.take_controls)
            self._try(self._hands.gripper.activate)

    def tell(self, event: GraspEvent) -> str:
        """Take the operator's order in; says what speaks against it, where something does."""
        if self.machine.tell(event):
            return ""
        if event is GraspEvent.HOLD and self.machine.state is GraspState.IDLE:
            self._hold_first = True  # once it begins, it holds
            return ""
        lacks = f"the order does not apply while the state is {self.machine.state.value}"
        return f"{event.value}: what lacks: {self.machine.lacks(event) or lacks}"

    def cycle(self, pair: StereoPair | None) -> LoopCycle:
        """Look, decide, order.

        Raises:
            InputError: the pictures are grey, or the selected box teaches no colour.
        """
        began = time.perf_counter()
        now = self._clock()
        observation = self._track(pair)
        reading = self._joints()
        if reading is not None:
            self._q, self.joints_t = reading.q, reading.t_host
        self.aim.update_hand(pair, reading)
        self._step_devices(now)
        self._watchdog.observe(now, self._inputs())
        self._act(now)
        return LoopCycle(
            now,
            self.machine.state,
            self.reason,
            pair,
            observation,
            self.aim.target,
            self._q,
            None if self._hands is None else self._hands.arm.q,
            self._fingers,
            time.perf_counter() - began,
        )

    def _track(self, pair: StereoPair | None) -> TargetObservation | None:
        if pair is None:
            return None
        self.pictures_t = pair.t_left
        if self._tracker is None:
            return None
        observation = self._tracker.step(pair)
        if observation.status == "tracked":
            self._tracked_t = pair.t_left
        self.aim.update_target(observation)
        return observation

    def _step_devices(self, now: float) -> None:
        """Let the devices go on; start once they are ready."""
        ready = True
        if self._hands is not None:
            self.arm, self._fingers = self._hands.arm.step(), self._hands.gripper.step()
            ready = self._hands.arm.takes_orders and self._fingers.state is GripperState.READY
        old = self._watchdog.old(now, self.pictures_t, self.joints_t)
        self.awaited = ", ".join([*old, *["arm or gripper not ready"] * (not ready)])
        started = not self.awaited and self.machine.tell(GraspEvent.START)
        if started and self._hold_first:
            self.machine.tell(GraspEvent.HOLD)

    def _inputs(self) -> Observation:
        """State the watchdog's inputs of this cycle."""
        error = self._refused
        if self.arm is not None and self.arm.state is MoverState.FAILED:
            error = f"the arm: {self.arm.reason}"
        if self._fingers is not None and self._fingers.state is GripperState.FAILED:
            error = f"the gripper: {self._fingers.reason}"
        target = self.aim.target
        hidden = self._near_object()
        unreachable = self.aim.unreachable
        if self.machine.state is GraspState.APPROACHING:
            unreachable = "" if hidden else self.aim.target_shift()
        return Observation(
            self.pictures_t,
            self.joints_t,
            self._tracked_t,
            target.thing.position if target is not None and target.tracked else None,
            unreachable,
            error,
            hidden,
        )

    def _near_object(self) -> bool:
        """The hand is so near that it may hide the object."""
        if self.aim.plan is None or self._q is None:
            return False
        grip = self._setup.grip(self._q)[:3, 3]
        away = float(np.linalg.norm(grip - self.aim.plan.margin.grip))
        return away <= self._setup.cell.approach.hidden

    def _act(self, now: float) -> None:
        """Order what the state asks for; plan where it is time to."""
        machine, hands = self.machine, self._hands
        entered = machine.state is not self._acted
        self._acted = machine.state
        if hands is not None:
            self._try(lambda: self._order(now, hands, entered=entered))
            return
        if machine.state is GraspState.RELEASING:
            machine.tell(GraspEvent.STOPPED)  # nothing was taken
        if machine.state in AIMING_STATES and machine.still and self._q is not None:
            self.aim.plan_now(now, self._q)
        machine.planned = self.aim.plan is not None

    def _try(self, ordered: Callable[[], None]) -> None:
        """Give an order; a refusal is a device's error, and the next cycle stops for it."""
        try:
            ordered()
        except (MotionRefusedError, ValueError) as refusal:
            self._refused = str(refusal)

    def _order(self, now: float, hands: Actuators, *, entered: bool) -> None:
        """Order what the state asks for; `entered`: the state is a new one."""
        arm, order = hands.arm, self.machine.order
        if self.machine.state in AIMING_STATES and arm.q is not None:
            self._stand_above(now, arm, arm.q)
        elif order is DeviceOrder.DESCEND:
            self._descend(arm, entered=entered)
        elif order in (DeviceOrder.LIFT, DeviceOrder.RETREAT):
            self._go_up(arm)
        elif order in (DeviceOrder.CLOSE, DeviceOrder.CHECK, DeviceOrder.OPEN):
            arm.hold()
            self._grip(hands.gripper, order, entered=entered)
        elif order is DeviceOrder.RELEASE or self.machine.state is GraspState.RELEASED:
            arm.hold()
            if arm.resting:
                arm.mover.release()
            if self.arm is not None and self.arm.given_back:
                self.machine.tell(GraspEvent.STOPPED)
        elif order is DeviceOrder.HOLD and arm.takes_orders:
            arm.hold()
            if self._fingers is not None and self._fingers.state is GripperState.MOVING:
                hands.gripper.stop()

    def _stand_above(self, now: float, arm: DrivenArm, q_ordered: Array) -> None:
        """Stand above the target; plan the grasp once both are at rest."""
        machine = self.machine
        goal = self.aim.hover(now, q_ordered, still=machine.still)
        above, obstacle = True, ""
        if machine.state is GraspState.FOLLOWING and goal is not None:
            obstacle = arm.follow(goal)
            assert arm.q is not None  # it was ordered before
            above = bool(np.abs(goal.q - arm.q).max() < TOL_SAME_GOAL)
        else:
            arm.hold()
        # an obstacle may keep it from standing there: then it is planned for from here
        settled = (above or bool(obstacle)) and arm.arrived(self._q)
        ready = machine.still and settled
        if ready:
            assert arm.q is not None
            self.aim.plan_now(now, arm.q)
        elif machine.state is GraspState.FOLLOWING:
            self.aim.forget()
        machine.planned = ready and self.aim.plan is not None

    def _descend(self, arm: DrivenArm, *, entered: bool) -> None:
        plan = self.aim.plan
        assert plan is not None  # the transition needs one
        if entered:
            arm.begin(plan.over, plan.down)
        arm.go()
        if arm.arrived(self._q):
            self.machine.tell(GraspEvent.AT_OBJECT)

    def _go_up(self, arm: DrivenArm) -> None:
        holds = self._fingers is not None and self._fingers.state is GripperState.GRIPPED
        if self.machine.state is GraspState.LIFTING and not holds:
            self.machine.tell(GraspEvent.NOTHING_HELD)
        if not arm.going_back:
            arm.hold()  # a stop may be under way
            if not arm.resting:
                return
            arm.begin_back()
        arm.go()
        if arm.arrived(self._q):
            self.machine.tell(GraspEvent.AT_TOP)

    def _grip(self, gripper: Gripper, order: DeviceOrder, *, entered: bool) -> None:
        fingers = self._fingers
        assert fingers is not None  # read before every order
        if order is DeviceOrder.CHECK:
            held = fingers.state is GripperState.GRIPPED
            self.machine.tell(GraspEvent.HELD if held else GraspEvent.NOTHING_HELD)
        elif order is DeviceOrder.CLOSE and entered:
            gripper.go_to(0.0, closing=True)
        elif order is DeviceOrder.CLOSE and fingers.state in CLOSED_STATES:
            self.machine.tell(GraspEvent.CLOSED)
        elif order is DeviceOrder.OPEN and fingers.state is GripperState.IDLE:
            gripper.activate()  # a stop has ended it
        elif order is DeviceOrder.OPEN and (entered or fingers.state is GripperState.READY):
            gripper.go_to(self._setup.cell.gripper.opening, closing=False)
        elif order is DeviceOrder.OPEN and fingers.state is GripperState.REACHED:
            self.machine.tell(GraspEvent.OPENED)
