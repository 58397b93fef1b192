"""Who wants to know how far work is."""

from collections import Counter


class Told:
    """A reporter that counts."""

    def __init__(self):
        self.total, self.done, self.steps, self.open = Counter(), Counter(), Counter(), []

    def start(self, stage, total, unit):
        self.open.append(stage)
        self.total[stage] += total

    def advance(self, done):
        self.done[self.open[-1]] += done
        self.steps[self.open[-1]] += 1

    def finish(self):
        self.open.pop()
