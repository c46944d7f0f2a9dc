"""A hand's posture and an object's shape in, contacts out."""
