"""Power flow of balanced radial feeders: one method a file, its compiled, array and adjoint forms beside it."""
