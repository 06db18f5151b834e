"""`njit`: numba's, with machine code kept on disk that is checked before it is loaded.

numba unpickles and runs what its cache files hold. After a power cut these may be cut, empty or garbled, and may belong
to another version of a function: the file of an index and that of its code are not written together. Here each file
ends with two checksums: of what it was made for, and of its name and content. What does not agree is dropped and
compiled again, with one line of notice where a file was damaged. Files keep numba's names and places.
"""

# mypy: disallow-subclassing-any=False

import contextlib
import functools
import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from typing import Any

import llvmlite.binding
import numba
import numba.core.options

try:
    from numba.core.caching import FunctionCache, IndexDataCacheFile
    from numba.core.registry import CPUDispatcher
    from numba.core.runtime import rtsys
    from numba.core.typing.typeof import typeof_impl
except ImportError:  # numba's insides are its own: without these names its plain cache serves
    FunctionCache = IndexDataCacheFile = None
else:
    # The type of a compiled function that is an argument is found by a walk over all types that numba knows. The first
    # function that a process compiles adds some; in a thread that walks meanwhile a call fails. So it is known at once.
    typeof_impl.register(CPUDispatcher, typeof_impl.dispatch(object))

if numba.config.CPU_FEATURES is None and numba.config.ENABLE_AVX:
    # LLVM halves vectors of 512 bits on many processors, to spare mixed code a lower clock; loops over kernels are all
    # vectors. NUMBA_CPU_FEATURES says otherwise where somebody sets it.
    with contextlib.suppress(RuntimeError):  # a processor that LLVM cannot ask
        numba.config.CPU_FEATURES = f"{llvmlite.binding.get_host_cpu_features().flatten()},-prefer-256-bit"

FAST = {"contract", "arcp", "nsz"}
"""What loops may do faster than IEEE 754 has it: products and sums in one step, reciprocals; 0 without a sign."""
DIGEST = hashlib.sha256
SIZE = DIGEST().digest_size

_told = False


def njit(*signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit(cache=True)`, whose files are checked, and which does without them where they cannot be kept.

    Parameters
    ----------
    signature
        The types of the arguments, to compile at once; without any, the first call compiles.
    options
        As `numba.njit` takes them.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        if FunctionCache is None:
            return numba.njit(*filter(None, [signature]), cache=True, **options)(function)
        dispatcher = numba.njit(**options)(function)
        if dispatcher is function:  # NUMBA_DISABLE_JIT
            return function
        try:
            dispatcher._cache = _Cache(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            # neither the package's folder nor the user's cache can be written: no cache, then
        if signature:
            dispatcher.compile(signature)
            dispatcher.disable_compile()
        return dispatcher

    return compiled


def counting(references: bool) -> dict[str, bool]:
    """An option of `njit`: whether code counts references to arrays; without, it makes none. Nothing where numba has no
    such option."""
    return {"_nrt": references} if hasattr(numba.core.options.DefaultOptions, "_nrt") else {}


def tell(text: str) -> None:
    """One line on stderr, once a process."""
    global _told
    if not _told and sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):  # nobody listens
            print(f"gonio: {text}", file=sys.stderr, flush=True)
    _told = True


if FunctionCache is not None:

    class _Files(IndexDataCacheFile):
        """An index and the files of code that it names, each with its checksums at the end."""

        def __init__(self, plain: Any) -> None:
            self.__dict__.update(plain.__dict__)

        def save(self, key: Any, data: Any) -> None:
            index = self._load_index()
            if key not in index:
                index[key] = next(
                    name for name in map(self._data_name, range(1, len(index) + 2)) if name not in index.values()
                )
            self._write(self._data_path(index[key]), self._dump(data), key)
            self._write(self._index_path, pickle.dumps(self._version) + self._dump((self._source_stamp, index)), "")

        def load(self, key: Any) -> Any:
            name = self._load_index().get(key)
            content = self._read(self._data_path(name), key) if name is not None else None
            return None if content is None else pickle.loads(content)

        def _load_index(self) -> dict[Any, str]:
            content = self._read(self._index_path, "")
            if content is None:
                return {}
            stamp, index = pickle.loads(content[len(pickle.dumps(self._version)) :])
            return index if stamp == self._source_stamp else {}

        def _made_for(self, key: Any) -> bytes:
            return DIGEST(repr((self._version, self._source_stamp if key else "", key)).encode()).digest()

        def _write(self, path: str, content: bytes, key: Any) -> None:
            content += self._made_for(key)
            with self._open_for_write(path) as file:
                file.write(content + _checksum(path, content))

        def _read(self, path: str, key: Any) -> bytes | None:
            """What a file holds; None where it is not there, was made for something else, or is damaged."""
            try:
                with open(path, "rb") as file:
                    content = file.read()
            except FileNotFoundError:
                return None
            except OSError as error:
                tell(f"{path}: cannot be read ({error.strerror}), so its function is compiled again")
                return None
            content, checksum = content[:-SIZE], content[-SIZE:]
            if checksum != _checksum(path, content):
                tell(f"{path}: compiled code on disk was damaged; it is compiled again, which takes seconds")
                return None
            return content[:-SIZE] if content[-SIZE:] == self._made_for(key) else None

    class _Cache(FunctionCache):
        """The cache of one function: what goes wrong with it costs time, and nothing else."""

        def __init__(self, function: Callable[..., Any]) -> None:
            super().__init__(function)
            self._cache_file: Any = _Files(self.__dict__["_cache_file"])

        def load_overload(self, signature: Any, target: Any) -> Any:
            try:
                rtsys.initialize(target)  # the rest of what `super` prepares is for compiling, and takes 0.2 s
                with self._guard_against_spurious_io_errors():
                    found = self._load_overload(signature, target)
                if found is None:
                    _say_once(self.cache_path)
                return found
            except Exception as error:  # whole, and yet of no use to this numba
                tell(f"{self.cache_path}: compiled code on disk cannot be used ({error!r:.100}); it is compiled again")
                return None

        def _index_key(self, signature: Any, codegen: Any) -> Any:
            """Compiled functions that a closure holds count by their names: numba's own differ in each process."""
            function: Any = self.__dict__["_py_func"]
            if function.__closure__ is None:
                return super()._index_key(signature, codegen)
            held = [getattr(cell.cell_contents, "__qualname__", cell.cell_contents) for cell in function.__closure__]
            return signature, codegen.magic_tuple(), DIGEST(function.__code__.co_code + repr(held).encode()).hexdigest()

        def save_overload(self, signature: Any, data: Any) -> None:
            try:
                super().save_overload(signature, data)
            except OSError as error:
                tell(f"{self.cache_path}: compiled code cannot be kept ({error.strerror}): each start compiles again")


@functools.cache
def _say_once(folder: str) -> None:
    """On a terminal: why the first command takes longer than later ones."""
    if sys.stderr is not None and sys.stderr.isatty():
        tell(f"compiling for this processor: seconds for each model, once; kept in {os.path.dirname(folder)}")


def _checksum(path: str, content: bytes) -> bytes:
    return DIGEST(os.path.basename(path).encode() + b"\0" + content).digest()
