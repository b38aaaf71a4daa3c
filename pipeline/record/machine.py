"""What this machine is and has: processor, memory, free disk, versions of what computes."""

import os
import platform
import shutil
import stat
import sys
import tempfile
from importlib import metadata
from pathlib import Path

_PACKAGES = ("numpy", "scipy", "numba", "h5py", "gmsh", "fenics-dolfinx", "petsc4py", "mpi4py")


def version() -> str:
    """Version of the installed perilife, or `0+unknown` when it is not installed."""
    try:
        return metadata.version("perilife")
    except metadata.PackageNotFoundError:
        return "0+unknown"


def package_versions() -> dict[str, str]:
    """Versions of perilife, Python and the packages that compute, as far as installed."""
    versions = {"perilife": version(), "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def processor_cores() -> int:
    """Cores that this process may use (its affinity, not what the machine holds)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def prepare_libraries() -> None:
    """Tell the libraries that compute what they ask the environment for; before they are imported.

    What the person has set stays as it is.
    """
    # Threads that wait must not spin: on a busy machine that costs hundreds of times the work.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    find_place_for_compiled_code()


def find_place_for_compiled_code(sources: Path = Path(__file__).parent) -> None:
    """Tell Numba (NUMBA_CACHE_DIR) a folder of this user where it would find none and give up.

    Numba keeps compiled kernels beside their source (sources: a folder of such) or below the home
    folder; where neither can be written (an installed copy, a container without home) it refuses
    to compile.  To be called before Numba is imported; children inherit it.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    if _can_write(sources / "__pycache__") or _can_write(Path(home, "numba")):
        return
    place = Path(tempfile.gettempdir(), f"perilife-{os.getuid()}")
    place.mkdir(mode=0o700, exist_ok=True)
    status = place.lstat()
    if status.st_uid != os.getuid() or status.st_mode & 0o7777077 != stat.S_IFDIR:
        # somebody else's: compiled code is not to be read from there
        place = Path(tempfile.mkdtemp(prefix="perilife-"))
    os.environ["NUMBA_CACHE_DIR"] = str(place)


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


_OF_A_RANK = ("OMPI_COMM_WORLD_", "PMIX_", "PMI_", "PRTE_", "HYDI_", "OMPI_MCA_orte_")
_OF_A_RANK += ("OMPI_MCA_ess", "OMPI_MCA_pmix", "OMPI_MCA_initial_wdir", "OMPI_MCA_shmem_RUNTIME")
_OF_A_RANK += ("OMPI_APP_CTX_", "OMPI_NUM_APP_CTX", "OMPI_FIRST_RANKS", "OMPI_FILE_LOCATION")
_OF_A_RANK += ("OMPI_UNIVERSE_SIZE", "OMPI_COMMAND", "OMPI_ARGV")
"""Beginnings of the variables by which a launcher tells a rank who it is."""


def child_environment(ranks: int, threads: int | None) -> dict[str, str]:
    """Environment of a child process that imports this checkout, alone or under mpirun.

    ranks: how many start together, 1 for a single one; each gets one thread of OpenMP (BLAS) and
    the settings of Open MPI.  0: one process that knows nothing of MPI and keeps the OpenMP
    threads of the caller.  threads: of Numba, each rank's own, None leaves the choice to the child.
    What tells this process which rank it is, where it is one, is left out: a child that took it for
    its own would end in MPI_Init.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(_OF_A_RANK)}
    # threads and ranks that wait give their core away: on a busy machine spinning costs many times
    # the work
    environment.setdefault("OMP_WAIT_POLICY", "passive")
    if ranks:
        environment["OMP_NUM_THREADS"] = "1"
        environment["OMPI_MCA_rmaps_base_oversubscribe"] = "1"
        environment["OMPI_MCA_mpi_yield_when_idle"] = "1"
        environment["OMPI_MCA_hwloc_base_binding_policy"] = "none"
        if os.geteuid() == 0:
            environment["OMPI_ALLOW_RUN_AS_ROOT"] = "1"
            environment["OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"] = "1"
    if threads is not None:
        environment["NUMBA_NUM_THREADS"] = str(threads)
    root = str(Path(__file__).resolve().parents[2])
    environment["PYTHONPATH"] = os.pathsep.join(
        part for part in (root, environment.get("PYTHONPATH", "")) if part
    )
    return environment


def check_counts(
    ranks: int, workers: int | None, oversubscribe: bool = False, option: str = "--np"
) -> None:
    """Refuse ranks (`option`) and pulls at a time (--pulls) that are out of range.

    Together at most as many as there are cores, unless `oversubscribe`.
    """
    for name, value in ((option, ranks), ("--pulls", workers)):
        if value is not None and not 1 <= value <= 4096:
            raise ValueError(f"{name} is {value}; it must be 1 to 4096")
    cores = processor_cores()
    if oversubscribe or ranks * (workers or 1) <= cores:
        return
    if ranks > cores:
        asked, most = f"{option} is {ranks}", cores
    else:
        each = f" of {ranks} ranks each" if ranks > 1 else ""
        asked, most = f"--pulls is {workers}{each}", cores // ranks
    raise ValueError(
        f"{asked} and this process may use {cores} cores; it must be at most {most}, or "
        "--oversubscribe be given"
    )


def mpirun(ranks: int, asked_by: str) -> list[str]:
    """Start of a command for several ranks; FileNotFoundError where mpirun is not installed."""
    program = shutil.which("mpirun")
    if program is None:
        raise FileNotFoundError(
            f"mpirun was not found on PATH; it must be installed for {asked_by}"
        )
    return [program, "-n", str(ranks)]


def describe_machine() -> dict[str, object]:
    """Processor, cores, memory and system, for benchmarks and reports."""
    return {
        "processor": _processor_name(),
        "cores": processor_cores(),
        "memory_bytes": total_memory(),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
    }


def total_memory() -> int:
    """Physical memory in bytes, or the control group's limit where that is smaller."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limit = _control_group_number("memory.max")
    return min(total, limit) if limit else total


def available_memory() -> int:
    """Bytes that a new computation may take without swapping (Linux), else the total."""
    available = _meminfo("MemAvailable") or total_memory()
    limit, used = _control_group_number("memory.max"), _control_group_number("memory.current")
    if limit and used is not None:
        available = min(available, max(limit - used, 0))
    return available


def free_disk(folder: Path) -> int:
    """Free bytes on the file system that holds `folder` or its nearest existing parent."""
    folder = Path(folder).absolute()
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free


def _processor_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or sys.platform


def _meminfo(key: str) -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith(key + ":"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return None


def _control_group_number(name: str) -> int | None:
    try:
        text = Path("/sys/fs/cgroup", name).read_text().strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None
