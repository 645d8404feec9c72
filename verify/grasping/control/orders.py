"""Order arm and gripper what the state asks for, and tell the state machine what they have done."""

from dataclasses import dataclass

import numpy as np

from verify.core.records import Array
from verify.grasping.actuators.protocols import Gripper, GripperState, GripperStatus
from verify.grasping.control.aim import Aim
from verify.grasping.control.arm import TOL_SAME_GOAL, DrivenArm
from verify.grasping.control.states import DeviceOrder, GraspEvent, GraspState, StateMachine
from verify.grasping.planning.plan import GraspPlanner

RESTING_STATES = frozenset(
    {GripperState.REACHED, GripperState.GRIPPED, GripperState.UNSURE, GripperState.LOST}
)
AIMING_STATES = frozenset(
    {GraspState.TRACKING, GraspState.FOLLOWING, GraspState.HOLDING_UNREACHABLE}
)


@dataclass(frozen=True, slots=True)
class Actuators:
    """What moves; there is none without the operator's right."""

    arm: DrivenArm
    gripper: Gripper


class OrderDispatcher:
    """Gives the orders of a state, one cycle at a time.

    Args:
        setup: arm and cell.
        aim: the goal above the target, and the plan.
        actuators: arm and gripper.
        machine: its state asks for the orders.
    """

    def __init__(
        self, setup: GraspPlanner, aim: Aim, actuators: Actuators, machine: StateMachine
    ) -> None:
        self._setup, self._aim, self._machine = setup, aim, machine
        self._arm, self._gripper = actuators.arm, actuators.gripper
        self._q: Array | None = None
        self._fingers: GripperStatus | None = None

    def give(
        self, now: float, q: Array | None, fingers: GripperStatus | None, *, entered: bool
    ) -> None:
        """Order what the state asks for.

        Args:
            now: s.
            q: (n,), rad, as read last; None: never yet.
            fingers: the gripper's status.
            entered: the state is a new one.

        Raises:
            MotionRefusedError, ValueError: a device refuses it.
        """
        self._q, self._fingers = q, fingers
        arm, order = self._arm, self._machine.order
        if self._machine.state in AIMING_STATES and arm.q is not None:
            self._stand_above(now, arm.q)
        elif order is DeviceOrder.DESCEND:
            self._descend(entered=entered)
        elif order in (DeviceOrder.LIFT, DeviceOrder.RETREAT):
            self._go_up()
        elif order in (DeviceOrder.CLOSE, DeviceOrder.CHECK, DeviceOrder.OPEN):
            arm.hold()
            self._grip(order, entered=entered)
        elif order is DeviceOrder.RELEASE:
            arm.hold()
            if arm.resting:
                arm.mover.release()
                self._machine.tell(GraspEvent.STOPPED)
        elif order is DeviceOrder.HOLD and arm.takes_orders:
            arm.hold()
            if fingers is not None and fingers.state is GripperState.MOVING:
                self._gripper.stop()

    def _stand_above(self, now: float, q_ordered: Array) -> None:
        """Stand above the target; plan the grasp once both are at rest."""
        machine, arm = self._machine, self._arm
        goal = self._aim.hover(now, q_ordered, still=machine.still)
        above, obstacle = True, ""
        if machine.state is GraspState.FOLLOWING and goal is not None:
            obstacle = arm.follow(goal)
            assert arm.q is not None  # it was ordered before
            above = bool(np.abs(goal.q - arm.q).max() < TOL_SAME_GOAL)
        else:
            arm.hold()
        # an obstacle may keep it from standing there: then it is planned for from here
        settled = (above or bool(obstacle)) and self._arrived()
        ready = machine.still and settled
        if ready:
            assert arm.q is not None
            self._aim.plan_now(now, arm.q)
        elif machine.state is GraspState.FOLLOWING:
            self._aim.forget()
        machine.planned = ready and self._aim.plan is not None

    def _arrived(self) -> bool:
        return self._q is not None and self._arm.arrived(self._q)

    def _descend(self, *, entered: bool) -> None:
        plan = self._aim.plan
        assert plan is not None  # the machine asks for one
        if entered:
            self._arm.begin(plan.over, plan.down)
        self._arm.go()
        if self._arrived():
            self._machine.tell(GraspEvent.AT_OBJECT)

    def _go_up(self) -> None:
        arm = self._arm
        holds = self._fingers is not None and self._fingers.state is GripperState.GRIPPED
        if self._machine.state is GraspState.LIFTING and not holds:
            self._machine.tell(GraspEvent.NOTHING_HELD)
        if not arm.going_back:
            arm.hold()  # a stop may be under way
            if not arm.resting:
                return
            arm.begin_back()
        arm.go()
        if self._arrived():
            self._machine.tell(GraspEvent.AT_TOP)

    def _grip(self, order: DeviceOrder, *, entered: bool) -> None:
        gripper, fingers = self._gripper, self._fingers
        assert fingers is not None  # read before every order
        if order is DeviceOrder.CHECK:
            held = fingers.state is GripperState.GRIPPED
            self._machine.tell(GraspEvent.HELD if held else GraspEvent.NOTHING_HELD)
        elif order is DeviceOrder.CLOSE and entered:
            gripper.close_to(0.0)
        elif order is DeviceOrder.CLOSE and fingers.state in RESTING_STATES:
            self._machine.tell(GraspEvent.CLOSED)
        elif order is DeviceOrder.OPEN and fingers.state is GripperState.IDLE:
            gripper.activate()  # a stop has ended it
        elif order is DeviceOrder.OPEN and (entered or fingers.state is GripperState.READY):
            gripper.open_to(self._setup.cell.gripper.opening)
        elif order is DeviceOrder.OPEN and fingers.state is GripperState.REACHED:
            self._machine.tell(GraspEvent.OPENED)
