#include "scratch.h"

#include <stdatomic.h>
#include <stdlib.h>

/* Where the compiler watches memory, arrays have a gap behind them that no one may touch. */
#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#define GAP 64 /* bytes */
#else
#define ASAN_POISON_MEMORY_REGION(begin, bytes) ((void)0)
#define ASAN_UNPOISON_MEMORY_REGION(begin, bytes) ((void)0)
#define GAP 0
#endif

#define N_BLOCKS 32             /* each twice as large as the one before */
#define FIRST_BLOCK (1u << 20)  /* bytes */
#define ALIGNMENT 64            /* bytes: the widest vectors */

struct Arena {
    Arena *next;
    char *block[N_BLOCKS]; /* kept until the process ends */
    Mark mark;
    jmp_buf failure;
};

/* Arenas that no call uses. A thread may end at any time, so none keeps one. */
static Arena *idle = NULL;
static atomic_flag busy = ATOMIC_FLAG_INIT;
static _Thread_local Arena *current = NULL;

static void lock(void)
{
    while (atomic_flag_test_and_set_explicit(&busy, memory_order_acquire)) {
    }
}

static void unlock(void)
{
    atomic_flag_clear_explicit(&busy, memory_order_release);
}

Arena *arena_open(void)
{
    lock();
    Arena *arena = idle;
    if (arena != NULL)
        idle = arena->next;
    unlock();
    if (arena == NULL)
        arena = calloc(1, sizeof *arena);
    current = arena;
    return arena;
}

void arena_close(Arena *arena)
{
    arena->mark = (Mark){0, 0};
    current = NULL;
    lock();
    arena->next = idle;
    idle = arena;
    unlock();
}

jmp_buf *arena_failure(Arena *arena)
{
    return &arena->failure;
}

void *scratch_take(size_t bytes)
{
    Mark *at = &current->mark;
    size_t needed = (bytes + GAP + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    while (at->used + needed > (size_t)FIRST_BLOCK << at->block)
        if (++at->block == N_BLOCKS)
            longjmp(current->failure, 1);
        else
            at->used = 0;
    if (current->block[at->block] == NULL) {
        char *raw = malloc(((size_t)FIRST_BLOCK << at->block) + ALIGNMENT);
        if (raw == NULL)
            longjmp(current->failure, 1);
        current->block[at->block] = raw + (ALIGNMENT - (uintptr_t)raw % ALIGNMENT);
    }
    char *taken = current->block[at->block] + at->used;
    ASAN_UNPOISON_MEMORY_REGION(taken, bytes);
    ASAN_POISON_MEMORY_REGION(taken + bytes, needed - bytes);
    at->used += needed;
    return taken;
}

Mark scratch_mark(void)
{
    return current->mark;
}

void scratch_release(Mark mark)
{
    current->mark = mark;
}
