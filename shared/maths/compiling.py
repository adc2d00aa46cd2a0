"""Machine code of plain functions, made by Numba where that is installed, and kept between runs.

What Numba makes is kept as an object file that llvmlite alone loads, in a tenth of the time and of the memory that
Numba itself would take: a process that finds it never imports Numba. The file's name holds everything that it depends
on: the contents of the sources, the versions of both packages, and the processor.
"""

import ctypes
import hashlib
import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NamedTuple

MATHS = Path(__file__).parent
OPTIONS: dict[str, Any] = {"error_model": "numpy"}  # a division by zero is infinite, and no exception
LOOP_OPTIONS: dict[str, Any] = {"jit_options": OPTIONS, "strict": False}
RELEASE = "define void @NRT_MemInfo_call_dtor(ptr %memory) {\n ret void\n}\n"  # nothing is allocated, so never called

# What is called takes the address of a table, since each further argument would cost a call a tenth of a microsecond:
# places of the result and of an exception, then the arguments.
TABLE = """
declare i32 @main({types})
define i64 @called(ptr %table) {{
 %failure = getelementptr i64, ptr %table, i64 1
 {loads}
 %failed = call i32 @main({arguments})
 %fine = icmp eq i32 %failed, 0
 %result = load i64, ptr %table
 %told = select i1 %fine, i64 %result, i64 0
 ret i64 %told
}}
"""


class Code:
    """A function of addresses and numbers that returns an integer, 0 for a failure.

    Parameters
    ----------
    owner : object
        Of the code, which lives as long as it does.
    address : int
        Where the code is.
    """

    def __init__(self, owner: object, address: int) -> None:
        self._owner = owner
        self._function = ctypes.PYFUNCTYPE(ctypes.c_int64)(address)  # the interpreter's lock is held: it is not long

    def bound(self, *arguments: int) -> Callable[[], int]:
        """Make a call of it with these arguments, to be repeated."""
        table = (ctypes.c_int64 * (2 + len(arguments)))(0, 0, *arguments)
        return partial(self._function, ctypes.pointer(table))

    def __call__(self, *arguments: int) -> int:
        """Call it."""
        return self.bound(*arguments)()


_loaded: dict[Path, Code] = {}


class Program(NamedTuple):
    """What is compiled.

    Parameters
    ----------
    main : callable
        Returns the function of pointers and numbers that is called from outside. It is given what makes an array of a
        pointer and a shape.
    signature : str
        Of that function, in Numba's words. It returns an int64.
    parts : iterable of callable
        All that it calls, directly or not, and that is compiled as it is; nothing may allocate memory.
    loops : mapping of callable to callable
        What else it calls, and what to compile instead.
    """

    main: Callable[[Callable[..., Any]], Callable[..., Any]]
    signature: str
    parts: Iterable[Callable[..., Any]]
    loops: Mapping[Callable[..., Any], Callable[..., Any]]


def machine_code(program: Program) -> Code | None:
    """Fetch machine code, or make it, which takes seconds.

    Parameters
    ----------
    program : Program
        What is wanted.

    Returns
    -------
    Code or None
        None where Numba is not installed.
    """
    try:
        llvm: Any = import_module("llvmlite.binding")
        versions = metadata.version("numba"), metadata.version("llvmlite")
    except (ImportError, metadata.PackageNotFoundError):
        return None
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = *versions, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    path = _cache_folder() / f"{_digest(program, machine)}.o"
    if path not in _loaded:
        content = path.read_bytes() if path.is_file() else _compiled(program, llvm)
        _keep(path, content)
        _loaded[path] = _linked(content, llvm)
    return _loaded[path]


def _compiled(program: Program, llvm: Any) -> bytes:
    """Make an object file with one function, `main`."""
    import numba
    from numba.extending import overload, register_jitable

    for part in program.parts:
        register_jitable(**OPTIONS)(part)
    for original, instead in program.loops.items():
        overload(original, **LOOP_OPTIONS)(lambda *_, instead=instead: instead)
    made = numba.cfunc(program.signature, **OPTIONS)(program.main(vars(numba)["carray"]))
    module = llvm.parse_assembly(made.inspect_llvm())
    module.link_in(llvm.parse_assembly(RELEASE))
    # Numba wraps the function in one that raises exceptions in Python, for which Numba would have to be there.
    inner = module.get_function(made.native_name.removeprefix("cfunc."))
    inner.name = "main"
    module.link_in(llvm.parse_assembly(_table([str(argument.type) for argument in inner.arguments])))
    for function in module.functions:
        if not function.is_declaration and function.name != "called":
            function.linkage = "internal"
    target = _target(llvm)
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(target, llvm.PipelineTuningOptions()))
    unknown = [f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm.")]
    missing = [name for name in unknown if not llvm.address_of_symbol(name)]
    if missing:
        raise RuntimeError(f"the compiled functions need {', '.join(missing)} of Numba at run time")
    content: bytes = target.emit_object(module)
    return content


def _table(types: list[str]) -> str:
    """Make the function that is called from outside, of one that takes places of result and exception, then others."""
    loads = (
        f"%at{n} = getelementptr i64, ptr %table, i64 {n}\n %a{n} = load {kind}, ptr %at{n}\n"
        for n, kind in enumerate(types[2:], 2)
    )
    arguments = ("ptr %table", "ptr %failure", *(f"{kind} %a{n}" for n, kind in enumerate(types[2:], 2)))
    return TABLE.format(types=", ".join(types), loads=" ".join(loads), arguments=", ".join(arguments))


def _linked(content: bytes, llvm: Any) -> Code:
    """Load an object file."""
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target(llvm))
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    return Code(engine, engine.get_function_address("called"))


def _target(llvm: Any) -> Any:
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3,
        reloc="pic", codemodel="jitdefault", jit=True,
    )  # fmt: skip


def _digest(program: Program, machine: Iterable[str]) -> str:
    """Name for what the sources, the compiler and the processor make together."""
    digest = hashlib.sha256("\n".join((program.signature, *machine)).encode())
    functions = (program.main, machine_code, *program.parts, *program.loops, *program.loops.values())
    files = {Path(function.__code__.co_filename) for function in functions}
    for path in sorted(files.union(MATHS.glob("*.py"))):  # whose constants are frozen as well
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "obu"


def _keep(path: Path, content: bytes) -> None:
    """Write a file at once or not at all; where nothing can be written, it is made anew by every process."""
    if path.is_file():
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(content)
        part.replace(path)
    except OSError:
        return
