"""Command ``jaxgrasp kernel``: the folder of the C++ solver of one grasp."""

from jaxgrasp.cli.arguments import Kernel
from jaxgrasp.cli.terminal import show
from jaxgrasp.kernel import include_folder


def kernel_command(arguments: Kernel) -> int:
    """Print the folder of the headers, and without ``include`` how to compile a controller with them."""
    if arguments.include:
        show(str(include_folder()))
        return 0
    show(f"C++17 headers of the solver of one grasp: {include_folder()}")
    show("one_grasp.h: templates over real type and number of contacts; one_grasp_c.h: one function in C")
    show("g++ -std=c++17 -O3 -march=native -fno-math-errno -I$(jaxgrasp kernel --include) controller.cpp")
    return 0
