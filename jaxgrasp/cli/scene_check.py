"""``jaxgrasp scene``: ready scenes, and checks of others."""

from jaxgrasp.cli.scene_arguments import Check, ReadyScenes
from jaxgrasp.cli.terminal import show
from jaxgrasp.grip.scene_file import load_scene, ready_scenes, scene_path


def check_command(arguments: Check) -> int:
    """Say what a scene holds; whatever is wrong with it is raised."""
    scene = load_scene(scene_path(arguments.scene))
    show(scene.name)
    for table, entries in scene.tables().items():
        show(f"  {table}: " + ", ".join(f"{key} {value}" for key, value in entries.items()))
    return 0


def list_command(arguments: ReadyScenes) -> int:
    """Print name and title of each scene that ships with the package."""
    for name, path in ready_scenes().items():
        show(f"{name:12s} {load_scene(path).name}")
    return 0
