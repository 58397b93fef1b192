"""What device code of several methods shares: memory, the Morton order, even sequences, heaps of a lane, the variant."""
