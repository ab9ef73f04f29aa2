"""Bodies put elsewhere before anything moves, for tests of contacts."""

from pymunk._chipmunk import ffi, lib
from shapely.affinity import rotate, translate
from shapely.geometry import box


def footprint(pose):
    """The default robot's rectangle at a pose, by shapely."""
    turned = rotate(box(-0.2, -0.15, 0.2, 0.15), pose[2], origin=(0, 0), use_radians=True)
    return translate(turned, pose[0], pose[1])


def turn(world, robot, angle):
    """Have a robot face another way [rad]."""
    world.pose[robot, 2] = angle
    lib.cpBodySetAngle(_body(world, robot), angle)


def put(world, body, position):
    """Put a body, robots first, somewhere else [m]."""
    lib.cpBodySetPosition(_body(world, body), tuple(map(float, position)))


def _body(world, index):
    return ffi.cast("cpBody *", int(world.worlds.episode(0).bodies.addresses[index]))
