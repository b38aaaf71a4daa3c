"""Environment of the tests: one thread per MPI rank, no screen, ranks allowed anywhere."""

import os

# Set before NumPy, PETSc or VTK is imported by a test module.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Waiting threads give way: on a busy machine spinning ones cost a hundredfold.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")
# `mpirun -n 2` must also start in a container: as root, and on a machine with a single core.
os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT", "1")
os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
os.environ.setdefault("OMPI_MCA_rmaps_base_oversubscribe", "1")
