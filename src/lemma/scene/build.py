"""Compiles a scene's specification to a MuJoCo model."""

import math

from lemma.core.arguments import known
from lemma.core.engine import mujoco
from lemma.robots.ur.build import ARMS, JOINTS, ArmSpec, add_arm
from lemma.scene.camera_mounts import camera_mount
from lemma.scene.objects.bodies import (
    CONTACT_SOLIMP,
    CONTACT_SOLREF,
    FALLEN,
    OBJECT_FRICTION,
    add_object,
)
from lemma.scene.objects.palette import FLOOR, HORIZON, SKY, TABLE, TABLE_EDGE
from lemma.scene.rendering.model_cameras import add_camera
from lemma.scene.spec import SceneSpec
from lemma.scene.table import (
    FLOOR_Z_M,
    TABLE_HALF_Y_M,
    TABLE_THICKNESS_M,
    Gap,
    tops,
)

TIME_STEP_S = 0.005
"""Physics time step; the periods of 20 Hz control and 10 Hz recording are multiples."""
TICK_S = 0.01
"""Servo tick: the period at which skills observe the scene and command the arms."""
STEPS_PER_TICK = round(TICK_S / TIME_STEP_S)

_SKY_PX = 64

ACTUATIONS = ("position", "velocity", "torque")
"""Actuators of the arms: position servos, velocity servos, or torques (open loop)."""


def compile_model(spec: SceneSpec, actuation: str = "position") -> mujoco.MjModel:
    """Compile a scene.

    Args:
        spec: The scene.
        actuation: One of :data:`ACTUATIONS`.

    Raises:
        UnknownNameError: No such actuation or arm.
    """
    known("actuation", actuation, ACTUATIONS)
    world = mujoco.MjSpec()
    _set_options(world)
    _add_room(world)
    _add_table(world, spec.gap_m)
    for name, robot in zip(spec.robot_names, spec.robots, strict=True):
        add_arm(world, ARMS[robot.arm], name, robot.base, robot.color, robot.hand)
        pose, fovy = camera_mount(robot)
        add_camera(world, f"{name}/camera", pose, fovy)
        _set_actuation(world, name, ARMS[robot.arm], actuation)
    for placed in spec.objects:
        rests_m = spec.rests_m(placed)
        add_object(world, placed.entity, placed.pose, placed.mass_kg, rests_m)
    return world.compile()


def _set_options(world: mujoco.MjSpec) -> None:
    world.modelname = "lemma"
    world.compiler.degree = False
    world.compiler.usethread = False
    # Constant, so that clipping planes and lights are the same in every scene.
    world.stat.extent = 3.0
    world.stat.center = [0, 0, 0.2]
    option = world.option
    option.timestep = TIME_STEP_S
    # Implicit integration reduces accelerations after the contacts are solved, so that
    # held objects slip. Dampings are small enough for Euler integration.
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations = 100
    option.ls_iterations = 50
    option.tolerance = 1e-8
    # Friction is stiffer than the normal constraint, so that held objects do not creep.
    option.impratio = 300
    visual = world.visual
    visual.map.znear = 0.05
    visual.map.zfar = 5.0
    # Half the width of the shadow map: the table alone, for sharper shadows.
    visual.map.shadowclip = 0.9
    # No light moves with the camera, so that all cameras see the same colors.
    visual.headlight.ambient = [0.40, 0.40, 0.41]
    visual.headlight.diffuse = [0.0, 0.0, 0.0]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.rgba.haze = HORIZON


def _add_room(world: mujoco.MjSpec) -> None:
    body = world.worldbody
    _add_light(world, "sun", (0.15, 0.50, -1.0), (0.50, 0.49, 0.47), shadow=True)
    _add_light(world, "fill", (-0.65, -0.20, -0.8), (0.24, 0.25, 0.27), shadow=False)
    world.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        width=_SKY_PX,
        height=_SKY_PX * 6,
        rgb1=SKY[:3],
        rgb2=HORIZON[:3],
    )
    for name in ("floor", "table"):
        world.add_material(name=name, specular=0.0, shininess=0.0)
    body.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0, 0, FLOOR_Z_M],
        size=[0, 0, 0.1],
        rgba=FLOOR,
        material="floor",
        contype=FALLEN,
        conaffinity=FALLEN,
        friction=OBJECT_FRICTION,
        solref=CONTACT_SOLREF,
        solimp=CONTACT_SOLIMP,
        condim=4,
    )


def _add_table(world: mujoco.MjSpec, gap_m: Gap | None) -> None:
    """Add the table's tops, each on four legs."""
    body = world.worldbody
    low, inset = FLOOR_Z_M + TABLE_THICKNESS_M, 0.1
    sides = ("",) if gap_m is None else ("_left", "_right")
    for side, (left, right) in zip(sides, tops(gap_m), strict=True):
        body.add_geom(
            name=f"table{side}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.5 * (left + right), 0, -TABLE_THICKNESS_M / 2],
            size=[0.5 * (right - left), TABLE_HALF_Y_M, TABLE_THICKNESS_M / 2],
            rgba=TABLE,
            material="table",
            friction=OBJECT_FRICTION,
            solref=CONTACT_SOLREF,
            solimp=CONTACT_SOLIMP,
            condim=4,
        )
        for i, (x, y) in enumerate(
            (x, y) for x in (left + inset, right - inset) for y in (-1, 1)
        ):
            body.add_geom(
                name=f"leg{side}_{i}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[x, y * (TABLE_HALF_Y_M - inset), low / 2 - TABLE_THICKNESS_M],
                size=[0.04, 0.04, -low / 2],
                rgba=TABLE_EDGE,
                contype=0,
                conaffinity=0,
            )


def _add_light(
    world: mujoco.MjSpec,
    name: str,
    direction: tuple[float, float, float],
    color: tuple[float, float, float],
    *,
    shadow: bool,
) -> None:
    """Add a directional light."""
    world.worldbody.add_light(
        name=name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        # Viewpoint of the shadow map, whose centre is the table.
        pos=[-4.0 * component for component in direction],
        dir=direction,
        diffuse=color,
        # Low, because specular reflections look different in every camera.
        specular=[0.25 * component if shadow else 0.0 for component in color],
        castshadow=shadow,
    )


def _set_actuation(
    world: mujoco.MjSpec, robot: str, arm: ArmSpec, actuation: str
) -> None:
    """Replace the position servos of one arm if the actuation is another one."""
    if actuation == "position":
        return
    for joint, gain in zip(JOINTS, arm.damping, strict=True):
        motor = world.actuator(f"{robot}/{joint}")
        limit = float(motor.forcerange[1])
        motor.gainprm[:] = 0.0
        motor.biasprm[:] = 0.0
        if actuation == "torque":
            motor.gaintype = mujoco.mjtGain.mjGAIN_FIXED
            motor.biastype = mujoco.mjtBias.mjBIAS_NONE
            motor.gainprm[0] = 1.0
            motor.ctrlrange = [-limit, limit]
        else:
            motor.gainprm[0] = gain
            motor.biasprm[2] = -gain
            motor.ctrlrange = [-math.pi, math.pi]
