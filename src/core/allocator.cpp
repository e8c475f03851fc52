/// Memory allocation of the executables: jemalloc (Evans, "A scalable concurrent malloc(3)
/// implementation for FreeBSD", 2006) replaces libc's malloc. A step of a fit or an attack
/// allocates what the previous step has freed: tens of megabytes that would cause page faults, or
/// searches in libc's free lists. The settings therefore never return memory by themselves;
/// MemoryTrimmer returns it when a loop's memory grows. Large pages save address translations in
/// the hash grids.
extern "C" {
// jemalloc reads this before main; MALLOC_CONF in the environment overrides it.
extern const char* malloc_conf;
const char* malloc_conf = "dirty_decay_ms:-1,muzzy_decay_ms:-1,thp:always";
}
