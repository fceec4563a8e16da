"""The first scene: an instance, its physics, and an image of one of its cameras.

python examples/00_first_scene.py [PICTURE]
"""

import sys
from pathlib import Path

from PIL import Image

import lemma
from lemma.scene.rendering.renderer import Renderer

instance = lemma.load_instance("hook_stack", "test", 3)
print(instance.key, "|", instance.team, "|", instance.instructions["human"])

scene = lemma.Episode(instance).simulation.scene
for name in scene.spec.object_names:
    x, y, z = scene.pose(name).position
    print(f"{name:12} x {x:+.3f}  y {y:+.3f}  z {z:+.3f} m")

image = Renderer(640, 480).rgbd(scene.model, scene.data, "robot_0/camera")
print(f"depth from {image.depth_m.min():.2f} to {image.depth_m.max():.2f} m")

if len(sys.argv) > 1:
    path = Path(sys.argv[1])
    Image.fromarray(image.rgb).save(path)
    print("wrote", path)
