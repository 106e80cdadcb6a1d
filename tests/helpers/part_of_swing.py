"""A phase that is part of a swing with straight legs: nothing is held, and nothing is lost."""

from walker_jax import Phase


class PartOfSwing(Phase):
    """Its event is left to those that derive from it."""

    def begin(self, state):
        return state

    def vector_field(self, state):
        return self.walker.vector_field(state)

    def contact_force(self, state):
        return self.walker.contact_force(state)

    def end(self, state):
        return state
