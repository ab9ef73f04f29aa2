"""Chipmunk's bodies of one world, and its functions as compiled code calls them.

pymunk ships Chipmunk as a cffi module, whose functions have addresses. Compiled code calls these
without Python in between, which matters: a physics step takes 0.4 microseconds. Vectors go by
value, as two doubles, which is what the calling conventions of Linux and macOS make of them.
"""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic
from numpy.typing import NDArray
from pymunk._chipmunk import ffi, lib

from crowdbench.compiled import compiled_callback
from crowdbench.simulation.contact import Contact, ContactKind

KINDS: tuple[ContactKind, ...] = ("pedestrian", "obstacle", "wall", "robot")
_NOTHING, _PEDESTRIAN, _OBSTACLE, _WALL, _ROBOT = range(len(KINDS) + 1)
CONTACT = 4
"""Numbers of a contact: kind (0 is none, then KINDS), index, closing speeds [m/s] of the robot and
of the other."""

_CALLED = (
    "cpSpaceStep",
    "cpSpaceSetCollisionBias",
    "cpBodySetPosition",
    "cpBodySetVelocity",
    "cpBodySetAngularVelocity",
    "cpBodyGetPosition",
    "cpBodyGetVelocity",
    "cpArbiterGetShapes",
    "cpArbiterGetNormal",
    "cpShapeGetUserData",
    "cpShapeGetBody",
    "cpSpaceReindexShapesForBody",
    "cpSpaceAddBody",
    "cpSpaceRemoveBody",
)
(
    STEP,
    SET_BIAS,
    SET_POSITION,
    SET_VELOCITY,
    SET_TURN_RATE,
    GET_POSITION,
    GET_VELOCITY,
    _GET_SHAPES,
    _GET_NORMAL,
    _GET_LABEL,
    _GET_BODY,
    REINDEX,
    ADD_BODY,
    REMOVE_BODY,
) = range(len(_CALLED))


def _address(pointer: Any) -> int:
    return int(ffi.cast("uintptr_t", pointer))


FUNCTIONS: NDArray[np.uint64] = np.array(
    [_address(ffi.addressof(lib, name)) for name in _CALLED], dtype=np.uint64
)
"""Addresses in this process; kernels are given them, since machine code outlives a process."""

_LABEL = 1 << 20  # a shape's label is its kind times this, plus its index
_COLLIDES = 1  # Chipmunk's collision type of robots
_ANY = int(ffi.cast("uintptr_t", -1))  # and of everything
_MASS_OF_ROBOT, _MASS_OF_PERSON = 50.0, 70.0
_MOST_ROBOTS = 32  # in a scenario


def _call(builder: Any, result: ir.Type, values: Any) -> Any:
    """Call what lies at the address ``values[0]`` with the other values."""
    kind = ir.FunctionType(result, [value.type for value in values[1:]])
    return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])


def _call_void(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
    """The code of a call that returns nothing."""
    _call(builder, ir.VoidType(), values)
    return context.get_dummy_value()


@intrinsic
def set_number(context: Any, function: Any, item: Any, number: Any) -> Any:
    """Call ``void f(void *, double)``."""
    return types.void(types.uintp, types.uintp, types.float64), _call_void


@intrinsic
def set_vector(context: Any, function: Any, item: Any, x: Any, y: Any) -> Any:
    """Call ``void f(void *, cpVect)``."""
    return types.void(types.uintp, types.uintp, types.float64, types.float64), _call_void


@intrinsic
def vector_of(context: Any, function: Any, item: Any) -> Any:
    """Call ``cpVect f(void *)``; the vector is a tuple."""
    result = types.UniTuple(types.float64, 2)

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        answer = _call(builder, ir.LiteralStructType([ir.DoubleType()] * 2), values)
        parts = [builder.extract_value(answer, i) for i in range(2)]
        return context.make_tuple(builder, result, parts)

    return result(types.uintp, types.uintp), generate


@intrinsic
def _pointer(context: Any, function: Any, item: Any) -> Any:
    """Call ``void *f(void *)``; pointers are numbers."""

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return _call(builder, ir.IntType(64), values)

    return types.uintp(types.uintp, types.uintp), generate


@intrinsic
def _two_pointers(context: Any, function: Any, item: Any) -> Any:
    """Call ``void f(void *, void **, void **)``; what it writes is a tuple."""
    result = types.UniTuple(types.uintp, 2)

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        places = [builder.alloca(ir.IntType(64)) for _ in range(2)]
        _call(builder, ir.VoidType(), [*values, *places])
        return context.make_tuple(builder, result, [builder.load(place) for place in places])

    return result(types.uintp, types.uintp), generate


@intrinsic
def pass_body(context: Any, function: Any, space: Any, body: Any) -> Any:
    """Call ``void f(cpSpace *, cpBody *)``."""
    return types.void(types.uintp, types.uintp, types.uintp), _call_void


@intrinsic
def numbers_at(context: Any, address: Any) -> Any:
    """A pointer to doubles, of an address."""
    result = types.CPointer(types.float64)

    def generate(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], ir.DoubleType().as_pointer())

    return result(types.uintp), generate


@compiled_callback(types.void(types.uintp, types.uintp, types.CPointer(types.uint64)))
def _touch(arbiter, _space, hook):  # type: ignore[no-untyped-def]
    """Record the first thing each robot touches, when Chipmunk says that two shapes meet."""
    calls = carray(hook, (len(_CALLED) + 1,))
    contacts = carray(numbers_at(calls[len(_CALLED)]), (_MOST_ROBOTS, CONTACT))
    first, second = _two_pointers(calls[_GET_SHAPES], arbiter)
    # Chipmunk's normal points from the first shape to the second.
    x, y = vector_of(calls[_GET_NORMAL], arbiter)
    for mine, other, sign in ((first, second, 1.0), (second, first, -1.0)):
        label = np.int64(_pointer(calls[_GET_LABEL], mine))
        robot = label % _LABEL
        if label // _LABEL != _ROBOT or contacts[robot, 0] != 0.0:
            continue
        touched = np.int64(_pointer(calls[_GET_LABEL], other))
        vx, vy = vector_of(calls[GET_VELOCITY], _pointer(calls[_GET_BODY], mine))
        ux, uy = vector_of(calls[GET_VELOCITY], _pointer(calls[_GET_BODY], other))
        contacts[robot, 0], contacts[robot, 1] = touched // _LABEL, touched % _LABEL
        contacts[robot, 2] = vx * (sign * x) + vy * (sign * y)
        contacts[robot, 3] = -(ux * (sign * x) + uy * (sign * y))


_IDENTITY = ffi.new("cpTransform *", (1.0, 0.0, 0.0, 1.0, 0.0, 0.0))[0]
_APART = ffi.new("cpShapeFilter *", (1, 2**32 - 1, 2**32 - 1))[0]
"""Shapes of a group do not meet."""
_BEGIN = ffi.cast("cpCollisionBeginFunc", _touch.address)


class Bodies:
    """One world in a Chipmunk space of its own; a space that is used again remembers contacts.

    Attributes:
        space: address of the space.
        addresses: (R + P,) of the bodies of robots and pedestrians.
        contacts: (R, CONTACT) the first thing that each robot touches, written by physics steps.
    """

    def __init__(
        self,
        pose: NDArray[np.float64],
        corners: list[tuple[float, float]],
        position: NDArray[np.float64],
        radius: NDArray[np.float64],
        obstacles: NDArray[np.float64],
        walls: NDArray[np.float64],
        contacts: NDArray[np.float64],
        *,
        apart: bool = False,
    ) -> None:
        """Put everything into a new space, in a fixed order, on which contacts depend.

        Args:
            pose: (R, 3) of robots, x, y [m], heading [rad].
            corners: of their footprint [m].
            position, radius: (P, 2), (P,) of pedestrians [m].
            obstacles: (K, 3) x, y, radius [m].
            walls: (S, 4) x1, y1, x2, y2 [m].
            contacts: (R, CONTACT) C-contiguous; must outlive this.
            apart: pedestrians touch robots alone, neither each other nor what is static.
        """
        contacts[:] = 0.0
        self.contacts = contacts
        self._space = lib.cpSpaceNew()
        lib.cpSpaceSetCollisionSlop(self._space, 0.0)
        self._bodies: list[Any] = []
        self._shapes: list[Any] = []
        ground = lib.cpSpaceGetStaticBody(self._space)
        for r, (x, y, heading) in enumerate(pose.tolist()):
            body = self._add_body(_MASS_OF_ROBOT, x, y)
            lib.cpBodySetAngle(body, heading)
            shape = lib.cpPolyShapeNew(body, len(corners), corners, _IDENTITY, 0.0)
            lib.cpShapeSetCollisionType(shape, _COLLIDES)
            self._add_shape(shape, _ROBOT, r)
        for p, ((x, y), around) in enumerate(zip(position.tolist(), radius.tolist(), strict=True)):
            body = self._add_body(_MASS_OF_PERSON, x, y)
            self._add_shape(lib.cpCircleShapeNew(body, around, (0.0, 0.0)), _PEDESTRIAN, p)
        for k, (x, y, around) in enumerate(obstacles.tolist()):
            self._add_shape(lib.cpCircleShapeNew(ground, around, (x, y)), _OBSTACLE, k)
        for s, (x1, y1, x2, y2) in enumerate(walls.tolist()):
            self._add_shape(lib.cpSegmentShapeNew(ground, (x1, y1), (x2, y2), 0.0), _WALL, s)
        if apart:
            for shape in self._shapes[len(pose) :]:
                lib.cpShapeSetFilter(shape, _APART)
        self._hook = np.empty(len(FUNCTIONS) + 1, dtype=np.uint64)
        self._hook[:-1], self._hook[-1] = FUNCTIONS, contacts.ctypes.data
        handler = lib.cpSpaceAddCollisionHandler(self._space, _COLLIDES, _ANY)
        handler.beginFunc = _BEGIN
        handler.userData = ffi.cast("void *", self._hook.ctypes.data)
        self.space = _address(self._space)
        self.addresses = np.array([_address(body) for body in self._bodies], dtype=np.uint64)
        self.free = weakref.finalize(self, _free, self._space, self._shapes, self._bodies)
        self.free.atexit = False

    def touched(self, robot: int) -> Contact | None:
        """The first thing that a robot has touched."""
        kind, index, mine, others = self.contacts[robot].tolist()
        return Contact(KINDS[int(kind) - 1], int(index), mine, others) if kind else None

    def set_off(self, bias: float, velocities: list[list[float]]) -> None:
        """Begin a control period: pedestrians' velocities, and how fast overlaps vanish."""
        lib.cpSpaceSetCollisionBias(self._space, bias)
        robots = len(self._bodies) - len(velocities)
        for body, velocity in zip(self._bodies[robots:], velocities, strict=True):
            lib.cpBodySetVelocity(body, velocity)

    def keep_still(self, person: int) -> None:
        """Leave a pedestrian out of physics steps; contacts depend on its shape, which stays."""
        lib.cpSpaceRemoveBody(self._space, self._bodies[len(self.contacts) + person])

    def drive(self, robot: int, x: float, y: float, turn_rate: float) -> None:
        """Give a robot its velocity [m/s] and turn rate [rad/s]."""
        lib.cpBodySetVelocity(self._bodies[robot], (x, y))
        lib.cpBodySetAngularVelocity(self._bodies[robot], turn_rate)

    def step(self, duration: float) -> None:
        """Take a physics step of ``duration`` [s]."""
        lib.cpSpaceStep(self._space, duration)

    def position(self, body: int) -> tuple[float, float]:
        """Of a body, robots first [m]."""
        place = lib.cpBodyGetPosition(self._bodies[body])
        return place.x, place.y

    def velocity(self, body: int) -> tuple[float, float]:
        """Of a body, robots first [m/s]."""
        velocity = lib.cpBodyGetVelocity(self._bodies[body])
        return velocity.x, velocity.y

    def remove(self, robot: int) -> None:
        """Take a robot out of the space."""
        lib.cpSpaceRemoveShape(self._space, self._shapes[robot])
        lib.cpSpaceRemoveBody(self._space, self._bodies[robot])

    def _add_body(self, mass: float, x: float, y: float) -> Any:
        body = lib.cpBodyNew(mass, float("inf"))
        lib.cpBodySetPosition(body, (x, y))
        lib.cpSpaceAddBody(self._space, body)
        self._bodies.append(body)
        return body

    def _add_shape(self, shape: Any, kind: int, index: int) -> None:
        lib.cpShapeSetUserData(shape, ffi.cast("void *", kind * _LABEL + index))
        lib.cpSpaceAddShape(self._space, shape)
        self._shapes.append(shape)


def _free(space: Any, shapes: list[Any], bodies: list[Any]) -> None:
    """Give the memory back; the space goes first, since it looks at its bodies once more."""
    lib.cpSpaceFree(space)
    for shape in shapes:
        lib.cpShapeFree(shape)
    for body in bodies:
        lib.cpBodyFree(body)
