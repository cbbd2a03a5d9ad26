/* Tells every change of the files below a folder, in order, so that a test can make the disk as it was after each of them.
 *
 * Loaded before the C library (LD_PRELOAD). DISK_TRACE_ROOT is the folder, DISK_TRACE the file of records: a letter, the lengths of
 * path, other path and bytes as 32-bit numbers, an offset as a 64-bit number, then path, other path and bytes. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static const char *root;
static int record = -1;

__attribute__((constructor)) static void begin(void) {
    root = getenv("DISK_TRACE_ROOT");
    const char *file = getenv("DISK_TRACE");
    if (root && file) record = syscall(SYS_openat, AT_FDCWD, file, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static int is_below(const char *path) {
    size_t length = root ? strlen(root) : 0;
    size_t end = strlen(path);
    if (record < 0 || strncmp(path, root, length) || (path[length] != '/' && path[length] != 0)) return 0;
    /* The index of the log is memory that readers share; it is made again. */
    return end < 4 || strcmp(path + end - 4, "-shm");
}

static int path_of(int fd, char *path) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, PATH_MAX - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return is_below(path);
}

static void put(const void *bytes, size_t length) {
    while (length) {
        ssize_t done = syscall(SYS_write, record, bytes, length);
        if (done <= 0) _exit(99);
        bytes = (const char *)bytes + done;
        length -= done;
    }
}

static void tell(char what, const char *path, const char *other, uint64_t offset, const void *bytes, size_t length) {
    uint32_t sizes[3] = {strlen(path), strlen(other), length};
    put(&what, 1);
    put(sizes, sizeof sizes);
    put(&offset, sizeof offset);
    put(path, sizes[0]);
    put(other, sizes[1]);
    put(bytes, length);
}

/* Defines a function in place of the library's, which it calls as `next`. */
#define INSTEAD_OF(result, name, ...) \
    result name(__VA_ARGS__) { \
        static result (*next)(__VA_ARGS__); \
        if (!next) next = (result(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name); \
        char path[PATH_MAX]; \
        (void)path; \
        pthread_mutex_lock(&lock);
#define DONE(value) \
        pthread_mutex_unlock(&lock); \
        return value; \
    }

static int open_and_tell(int at, const char *path, int flags, mode_t mode) {
    char whole[PATH_MAX];
    pthread_mutex_lock(&lock);
    struct stat there;
    int was_there = fstatat(at, path, &there, 0) == 0;
    int fd = syscall(SYS_openat, at, path, flags, mode);
    if (fd >= 0 && (flags & (O_CREAT | O_TRUNC)) && path_of(fd, whole)) {
        if (!was_there) tell('c', whole, "", 0, "", 0);
        else if (flags & O_TRUNC) tell('t', whole, "", 0, "", 0);
    }
    pthread_mutex_unlock(&lock);
    return fd;
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, mode_t); \
        va_end(rest); \
        return open_and_tell(AT_FDCWD, path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name) \
    int name(int at, const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, mode_t); \
        va_end(rest); \
        return open_and_tell(at, path, flags, mode); \
    }
OPENAT(openat)
OPENAT(openat64)

INSTEAD_OF(ssize_t, write, int fd, const void *bytes, size_t length)
    off_t at = path_of(fd, path) ? lseek(fd, 0, SEEK_CUR) : 0;
    ssize_t done = next(fd, bytes, length);
    if (done > 0 && path_of(fd, path)) tell('w', path, "", at, bytes, done);
DONE(done)

#define PWRITE(name, offset_type) \
    INSTEAD_OF(ssize_t, name, int fd, const void *bytes, size_t length, offset_type at) \
        ssize_t done = next(fd, bytes, length, at); \
        if (done > 0 && path_of(fd, path)) tell('w', path, "", at, bytes, done); \
    DONE(done)
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define FSYNC(name) \
    INSTEAD_OF(int, name, int fd) \
        int done = next(fd); \
        if (!done && path_of(fd, path)) tell('s', path, "", 0, "", 0); \
    DONE(done)
FSYNC(fsync)
FSYNC(fdatasync)

#define FTRUNCATE(name, offset_type) \
    INSTEAD_OF(int, name, int fd, offset_type length) \
        int done = next(fd, length); \
        if (!done && path_of(fd, path)) tell('t', path, "", length, "", 0); \
    DONE(done)
FTRUNCATE(ftruncate, off_t)
FTRUNCATE(ftruncate64, off64_t)

INSTEAD_OF(int, rename, const char *from, const char *to)
    int done = next(from, to);
    if (!done && is_below(from)) tell('r', from, to, 0, "", 0);
DONE(done)

INSTEAD_OF(int, mkdir, const char *folder, mode_t mode)
    int done = next(folder, mode);
    if (!done && is_below(folder)) tell('m', folder, "", 0, "", 0);
DONE(done)

INSTEAD_OF(int, unlink, const char *file)
    int done = next(file);
    if (!done && is_below(file)) tell('u', file, "", 0, "", 0);
DONE(done)
