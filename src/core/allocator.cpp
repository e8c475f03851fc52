/// Memory of the programs, for executables alone: jemalloc (Evans, "A scalable concurrent malloc(3)
/// implementation for FreeBSD", 2006) in the place of libc's malloc, and how it keeps memory. A
/// step of a fit or an attack allocates what the one before has freed: tens of megabytes that would
/// fault in page by page, or be sought in libc's lists. So nothing goes back before the end, and
/// large pages save address look-ups in the hash grids.
extern "C" {
// jemalloc reads this before main; MALLOC_CONF in the environment rules over it.
extern const char* malloc_conf;
const char* malloc_conf = "dirty_decay_ms:-1,muzzy_decay_ms:-1,thp:always";
}
