"""What device code of several methods shares: memory, the Morton order, heaps of a lane, the variant."""
