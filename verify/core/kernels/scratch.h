/* Working memory of compiled functions: taken in order, given back in the reverse order.
 *
 * An entry, called from Python, opens an arena for itself; where memory ends, it returns OUT_OF_MEMORY:
 *
 *     int64_t entry_work(int64_t n, double *values) { GUARDED(work(n, values)); }
 */
#ifndef VERIFY_SCRATCH_H
#define VERIFY_SCRATCH_H

#include <setjmp.h>
#include <stddef.h>
#include <stdint.h>

#define OUT_OF_MEMORY (-1)

typedef struct {
    int block;
    size_t used; /* bytes of that block */
} Mark;

typedef struct Arena Arena;

Arena *arena_open(void); /* NULL where memory ends */
void arena_close(Arena *arena);
jmp_buf *arena_failure(Arena *arena);

/* So many bytes, aligned for vectors, until the mark that was set before is released. */
void *scratch_take(size_t bytes);
Mark scratch_mark(void);
void scratch_release(Mark mark);

#define TAKE(type, count) ((type *)scratch_take(sizeof(type) * (size_t)(count)))

/* Return what the call gives, an integer that is not negative. */
#define GUARDED(call)                                \
    Arena *arena = arena_open();                     \
    if (arena == NULL)                               \
        return OUT_OF_MEMORY;                        \
    if (setjmp(*arena_failure(arena))) {             \
        arena_close(arena);                          \
        return OUT_OF_MEMORY;                        \
    }                                                \
    int64_t guarded_result = (call);                 \
    arena_close(arena);                              \
    return guarded_result

#endif
