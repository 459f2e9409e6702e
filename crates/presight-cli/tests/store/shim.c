/* What a program does to the files of a folder, written down: for each call a record
 *   char kind; u32 length of the path; path; u64 offset or size; u64 length; data
 * W write, T truncate, S sync of a file, C creation, U removal, D sync of a folder, A what went to stdout.
 * With SHIM_FULL=N writes to the folder fail as on a full disk after N bytes. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define FDS 1024
static char *path_of[FDS];
static int trace = -1;
static const char *folder;
static long long room = -1;
static ssize_t (*real_write)(int, const void *, size_t);
static int (*real_open)(const char *, int, ...);
static int (*real_close)(int), (*real_fsync)(int), (*real_unlink)(const char *), (*real_ftruncate)(int, off_t);

__attribute__((constructor)) static void begin(void) {
    real_write = dlsym(RTLD_NEXT, "write");
    real_open = dlsym(RTLD_NEXT, "open");
    real_close = dlsym(RTLD_NEXT, "close");
    real_fsync = dlsym(RTLD_NEXT, "fsync");
    real_unlink = dlsym(RTLD_NEXT, "unlink");
    real_ftruncate = dlsym(RTLD_NEXT, "ftruncate");
    folder = getenv("SHIM_FOLDER");
    const char *to = getenv("SHIM_TRACE"), *full = getenv("SHIM_FULL");
    if (folder && to) trace = real_open(to, O_WRONLY | O_CREAT | O_APPEND, 0666);
    if (full) room = atoll(full);
}

static void record(char kind, const char *path, uint64_t offset, const void *data, uint64_t length) {
    if (trace < 0) return;
    uint32_t n = (uint32_t)strlen(path);
    size_t size = 1 + 4 + n + 8 + 8 + length;
    char *all = malloc(size), *at = all;
    *at++ = kind;
    memcpy(at, &n, 4), at += 4;
    memcpy(at, path, n), at += n;
    memcpy(at, &offset, 8), at += 8;
    memcpy(at, &length, 8), at += 8;
    if (length) memcpy(at, data, length);
    if (real_write(trace, all, size) != (ssize_t)size) abort();
    free(all);
}

static int ours(const char *path) { return folder && strncmp(path, folder, strlen(folder)) == 0; }
static const char *known(int fd) { return fd >= 0 && fd < FDS ? path_of[fd] : NULL; }

static int opened(const char *path, int flags, mode_t mode) {
    int there = access(path, F_OK) == 0;
    int fd = real_open(path, flags, mode);
    if (fd >= 0 && fd < FDS && ours(path)) {
        path_of[fd] = strdup(path);
        if (!there && (flags & O_CREAT)) record('C', path, 0, NULL, 0);
    }
    return fd;
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = flags & O_CREAT ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        return opened(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

int close(int fd) {
    if (known(fd)) {
        free(path_of[fd]);
        path_of[fd] = NULL;
    }
    return real_close(fd);
}

static int is_full(const char *path, size_t length) {
    if (room < 0 || !path) return 0;
    if ((long long)length > room) {
        room = 0;
        errno = ENOSPC;
        return 1;
    }
    room -= (long long)length;
    return 0;
}

ssize_t write(int fd, const void *data, size_t length) {
    const char *path = known(fd);
    if (is_full(path, length)) return -1;
    uint64_t offset = path ? (uint64_t)lseek(fd, 0, SEEK_CUR) : 0;
    ssize_t done = real_write(fd, data, length);
    if (done > 0 && path) record('W', path, offset, data, (uint64_t)done);
    if (done > 0 && fd == 1) record('A', "", 0, data, (uint64_t)done);
    return done;
}

#define PWRITE(name, off) \
    ssize_t name(int fd, const void *data, size_t length, off offset) { \
        static ssize_t (*real)(int, const void *, size_t, off); \
        if (!real) real = dlsym(RTLD_NEXT, #name); \
        const char *path = known(fd); \
        if (is_full(path, length)) return -1; \
        ssize_t done = real(fd, data, length, offset); \
        if (done > 0 && path) record('W', path, (uint64_t)offset, data, (uint64_t)done); \
        return done; \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

static int synced(int fd, int (*real)(int)) {
    int done = real(fd);
    struct stat s;
    if (done == 0 && known(fd) && fstat(fd, &s) == 0) record(S_ISDIR(s.st_mode) ? 'D' : 'S', known(fd), 0, NULL, 0);
    return done;
}
int fsync(int fd) { return synced(fd, real_fsync); }
int fdatasync(int fd) { return synced(fd, real_fsync); }

static int truncated(int fd, off_t size) {
    int done = real_ftruncate(fd, size);
    if (done == 0 && known(fd)) record('T', known(fd), (uint64_t)size, NULL, 0);
    return done;
}
int ftruncate(int fd, off_t size) { return truncated(fd, size); }
int ftruncate64(int fd, off64_t size) { return truncated(fd, (off_t)size); }

int unlink(const char *path) {
    int done = real_unlink(path);
    if (done == 0 && ours(path)) record('U', path, 0, NULL, 0);
    return done;
}
