"""A projection on a friction cone is a force that a contact can exert, wherever it comes from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics import vec3
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.friction_cone import Cone

COUNT = 2000


def projected(u, normal, friction):
    """Return projections ``(B, 3)``, their normal parts, and the sizes of their tangential ones."""
    cone = Cone(vec3.from_axis(normal, -1), friction)
    target = ContactVec(vec3.from_axis(u, -1))
    force = friction_cone.project(target, cone, friction_cone.decompose(target, cone)).linear
    along = vec3.dot(force, cone.normal)
    across = vec3.sub(force, vec3.scale(along, cone.normal))
    return jnp.stack(force, -1), along, vec3.norm(across)


def drawn(where: str):
    rng = np.random.default_rng(7)
    normal = rng.normal(size=(COUNT, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    tangent = np.cross(normal, rng.normal(size=(COUNT, 3)))
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    friction, size = rng.uniform(0.05, 1.5, COUNT), np.exp(rng.uniform(-20, 20, COUNT))
    along = {"beside the polar cone": -friction, "beside the cone": 1 / friction, "anywhere": rng.normal(size=COUNT)}
    u = size[:, None] * (tangent + along[where][:, None] * normal)
    return jnp.asarray(u), jnp.asarray(normal), jnp.asarray(friction)


@pytest.mark.parametrize("where", ["beside the polar cone", "beside the cone", "anywhere"])
def test_it_lies_in_the_cone_and_never_pulls(where):
    u, normal, friction = drawn(where)
    size = np.linalg.norm(u, axis=-1)
    for compiled in (True, False):
        with jax.disable_jit(not compiled):
            force, along, across = jax.jit(projected)(u, normal, friction)
        assert (along >= -1e-15 * np.linalg.norm(force, axis=-1)).all()
        assert (across <= friction * along + 1e-15 * size).all()


def test_projecting_twice_is_projecting_once():
    u, normal, friction = drawn("anywhere")
    once = projected(u, normal, friction)[0]
    apart = projected(once, normal, friction)[0] - once
    assert (jnp.abs(apart) <= 1e-14 * jnp.linalg.norm(once, axis=-1, keepdims=True)).all()


def test_what_is_left_is_at_right_angles_and_in_the_polar_cone():
    u, normal, friction = drawn("anywhere")
    force, size = projected(u, normal, friction)[0], np.linalg.norm(u, axis=-1)
    residual = u - force
    assert (np.abs(np.sum(residual * force, -1)) <= 1e-15 * size**2).all()
    along = np.sum(residual * normal, -1)
    across = np.linalg.norm(residual - along[:, None] * normal, axis=-1)
    # No allowed force works along it: the support is along + friction across.
    assert (along + friction * across <= 1e-14 * size).all()


def test_two_lengths_at_the_surface_are_told_apart_without_a_root():
    """A length of exactly zero lies inside, however a root of it would be compiled."""
    normal = jnp.tile(jnp.asarray([0.0, 0.0, 1.0]), (3, 1))
    u, friction = jnp.asarray([[0, 0, 1.0], [0, 0, 0.0], [0, 0, -1.0]]), jnp.full(3, 0.5)
    target = ContactVec(vec3.from_axis(u, -1))
    sides = friction_cone.decompose(target, Cone(vec3.from_axis(normal, -1), friction))
    assert sides.inside.tolist() == [True, True, False] and sides.polar.tolist() == [False, False, True]
    assert contact_vec.norm(target).tolist() == [1, 0, 1]


@pytest.mark.parametrize("push", [1.0, 1e4, 1e10, 1e20])
def test_bounds_hold_beside_a_push_far_beyond_them(push):
    """Rounding of so large a push leaves a normal part in what is tangential of it."""
    _, normal, friction = drawn("anywhere")
    tangent = np.cross(normal, np.random.default_rng(8).normal(size=normal.shape))
    for sign, bounds in ((1, {"normal_max": 2.0}), (-1, {"normal_min": 0.5})):
        limits = {name: jnp.full(COUNT, bound) for name, bound in bounds.items()}
        cone = Cone(vec3.from_axis(normal, -1), friction, **limits)
        target = ContactVec(vec3.from_axis(sign * push * normal + tangent, -1))
        force = friction_cone.project(target, cone, friction_cone.decompose(target, cone)).linear
        along = vec3.dot(force, cone.normal)
        assert (along <= limits.get("normal_max", jnp.inf) * (1 + 1e-14)).all()
        assert (along >= limits.get("normal_min", 0) * (1 - 1e-14)).all()
