"""How good a grasp is, whatever it must hold: force closure, inscribed balls, singular values, weights of a balance."""
