"""A medium that is measured from photographs, by the gradients of pictures."""
