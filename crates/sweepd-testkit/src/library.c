/* Receives through libsweepd as any program in C does, and says what came.
 *
 *     library talk NAME ROOT FOLDER [objects]   a JSON line for each line of standard input:
 *         next MS     gives back what is held, and waits for the next, whose bytes go to FOLDER/bytes
 *         hold MS     the same, and holds what was held, too
 *         sensors     the names
 *         fork        children try what is of their parent, and end; the last then waits for a sweep with a client of its own.
 *                     Lines: that client is connected; how the children ended, and whether what is held is as it came
 *         leave       ends the client, then says whether what is held is as it came, then gives it back on another thread
 *     library watch NAME ROOT                   a line a sweep: its run, its number, and a hash of its bytes as it came and some
 *                                               milliseconds later
 *     library obstacle FILE                     the nearest obstacle of the sweep in a file, for each line of standard input with a zone
 *                                               and two counts
 *     library wrong                             calls each function with what it must refuse
 */

#undef NDEBUG
#define _DEFAULT_SOURCE
#include <assert.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include "sweepd.h"

/* What is held, and a copy of each from when it came. */
static struct held {
    sweepd_sample *sample;
    void *copy;
} held[4];
static int held_len;

static uint64_t hash_of(const void *bytes, size_t len) {
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t at = 0; at < len; at++) hash = (hash ^ ((const uint8_t *)bytes)[at]) * 0x100000001b3u;
    return hash;
}

/* The file that is mapped where a place is, where in it that is, and how it may be used. */
static void say_mapping(const void *place) {
    unsigned long first, last, offset;
    char line[512], access[8], file[256];
    FILE *maps = fopen("/proc/self/maps", "r");
    while (fgets(line, sizeof line, maps) != NULL)
        if (sscanf(line, "%lx-%lx %7s %lx %*s %*s %255s", &first, &last, access, &offset, file) == 5 &&
            (uintptr_t)place >= first && (uintptr_t)place < last)
            printf(",\"file\":\"%s\",\"access\":\"%s\",\"offset\":%lu", file, access, offset + (unsigned long)((uintptr_t)place - first));
    fclose(maps);
}

static void say_text(const char *key, const char *text) {
    printf(",\"%s\":\"", key);
    for (; *text != '\0'; text++) {
        if (*text == '"' || *text == '\\') putchar('\\');
        printf(*text == '\n' ? "\\n" : "%c", *text);
    }
    putchar('"');
}

static void release_all(void) {
    while (held_len > 0) {
        held_len--;
        sweepd_sample_release(held[held_len].sample);
        free(held[held_len].copy);
    }
}

/* Whether what is held is as it came. */
static int is_same(void) {
    int same = 1;
    for (int at = 0; at < held_len; at++) {
        size_t len;
        const void *bytes = sweepd_sample_bytes(held[at].sample, &len);
        same &= bytes != NULL && memcmp(bytes, held[at].copy, len) == 0;
    }
    return same;
}

static void *release_all_here(void *nothing) {
    release_all();
    return nothing;
}

static void say_next(sweepd_client *client, int64_t limit_ns, const char *folder) {
    sweepd_sample *sample = NULL;
    char model[16] = "";
    const int32_t next = sweepd_client_next(client, limit_ns, &sample);
    printf("{\"next\":%d,\"missed\":%" PRIu64 ",\"reopened\":%" PRIu64 ",\"connected\":%d,\"published\":%d,\"waits\":%d", (int)next,
           sweepd_client_missed(client), sweepd_client_reopened(client), (int)sweepd_client_is_connected(client),
           (int)sweepd_client_is_published(client), (int)sweepd_client_has_next(client));
    if (sweepd_client_attribute(client, "model", model, sizeof model) != SIZE_MAX) say_text("model", model);
    if (next == SWEEPD_NEXT_INVALID || next == SWEEPD_NEXT_FAILED) say_text("error", sweepd_error());
    assert((sample != NULL) == (next == SWEEPD_NEXT_RECEIVED));
    if (sample != NULL) {
        size_t len;
        const void *bytes = sweepd_sample_bytes(sample, &len);
        char path[512];
        FILE *file;
        say_mapping(bytes);
        snprintf(path, sizeof path, "%s/bytes", folder);
        file = fopen(path, "wb");
        assert(fwrite(bytes, 1, len, file) == len && fclose(file) == 0);
        held[held_len].copy = malloc(len);
        memcpy(held[held_len].copy, bytes, len);
        held[held_len++].sample = sample;
    }
    printf("}\n");
}

static int is_refused(void) {
    return strstr(sweepd_error(), "before fork(): open one in this process") != NULL;
}

/* After fork(): what is of the parent is refused, and given back without an effect. Where there is a root, a client of the child's
 * own gets a sweep. */
static int in_child(sweepd_client *client, const char *name, const char *root) {
    sweepd_sample *sample;
    size_t len = 7;
    int32_t next;
    assert(sweepd_client_next(client, -1, &sample) == SWEEPD_NEXT_FAILED && sample == NULL && is_refused());
    assert(sweepd_client_objects(client) == NULL && is_refused());
    assert(sweepd_client_is_connected(client) == 0 && sweepd_client_missed(client) == 0);
    assert(sweepd_client_attribute(client, "model", NULL, 0) == SIZE_MAX);
    for (int at = 0; at < held_len; at++)
        assert(sweepd_sample_bytes(held[at].sample, &len) == NULL && len == 0 && is_refused());
    release_all();
    sweepd_client_close(client);
    if (root == NULL) return 0;
    client = sweepd_client_open(name, root);
    do {
        next = sweepd_client_next(client, 20000000, &sample);
    } while (next != SWEEPD_NEXT_FAILED && !sweepd_client_is_connected(client));
    printf("{\"next\":%d}\n", (int)next);
    fflush(stdout);
    next = sweepd_client_next(client, INT64_C(20000000000), &sample);
    sweepd_sample_release(sample);
    sweepd_client_close(client);
    return next;
}

static int talk(const char *name, const char *root, const char *folder, int is_objects) {
    char line[64];
    sweepd_client *client = sweepd_client_open(name, root);
    if (client != NULL && is_objects) {
        sweepd_client *objects = sweepd_client_objects(client);
        sweepd_client_close(client);
        client = objects;
    }
    if (client == NULL) {
        printf("{\"next\":-1");
        say_text("error", sweepd_error());
        printf("}\n");
        return 0;
    }
    while (fgets(line, sizeof line, stdin) != NULL) {
        if (strncmp(line, "sensors", 7) == 0) {
            char names[256] = "";
            printf("{\"length\":%zd", (ssize_t)sweepd_sensors(root, names, sizeof names));
            say_text("sensors", names);
            printf("}\n");
        } else if (strncmp(line, "fork", 4) == 0) {
            int failed = 0;
            fflush(stdout);
            for (int left = 40; left >= 0; left--) {
                int status = -1;
                const pid_t child = fork();
                if (child == 0) exit(in_child(client, name, left == 0 ? root : NULL));
                assert(waitpid(child, &status, 0) == child);
                failed += status != 0;
            }
            printf("{\"failed\":%d,\"held\":%d,\"same\":%d}\n", failed, held_len, is_same());
        } else if (strncmp(line, "leave", 5) == 0) {
            pthread_t thread;
            sweepd_client_close(client);
            printf("{\"held\":%d,\"same\":%d", held_len, is_same());
            pthread_create(&thread, NULL, release_all_here, NULL);
            pthread_join(thread, NULL);
            printf("}\n");
            fflush(stdout);
            return 0;
        } else {
            if (line[0] == 'n') release_all();
            say_next(client, atoll(line + 5) * 1000000, folder);
        }
        fflush(stdout);
    }
    sweepd_client_close(client);
    return 0;
}

static int watch(const char *name, const char *root) {
    sweepd_client *client = sweepd_client_open(name, root);
    sweepd_sample *sample;
    for (;;) {
        const int32_t next = sweepd_client_next(client, -1, &sample);
        sweepd_sweep sweep;
        uint64_t hash;
        size_t len;
        const void *bytes;
        if (next != SWEEPD_NEXT_RECEIVED) {
            fprintf(stderr, "%d: %s\n", (int)next, sweepd_error());
            return 1;
        }
        bytes = sweepd_sample_bytes(sample, &len);
        if (sweepd_open(bytes, len, &sweep) != SWEEPD_OK) return 2;
        hash = hash_of(bytes, len);
        usleep(20000);
        printf("%" PRId64 " %" PRIu64 " %" PRIu64 " %" PRIu64 "\n", sweep.header.run_ns, sweep.header.sequence, hash,
               hash_of(bytes, len));
        fflush(stdout);
        sweepd_sample_release(sample);
    }
}

static int obstacle(const char *path) {
    char line[512];
    FILE *file = fopen(path, "rb");
    size_t len;
    void *bytes;
    assert(file != NULL && fseek(file, 0, SEEK_END) == 0);
    len = (size_t)ftell(file);
    bytes = malloc(len);
    rewind(file);
    assert(fread(bytes, 1, len, file) == len && fclose(file) == 0);
    while (fgets(line, sizeof line, stdin) != NULL) {
        sweepd_zone zone;
        sweepd_least least;
        sweepd_obstacle found;
        assert(sscanf(line, "%lf %lf %lf %lf %lf %lf %" SCNu32 " %" SCNu32, &zone.least_m[0], &zone.least_m[1], &zone.least_m[2],
                      &zone.most_m[0], &zone.most_m[1], &zone.most_m[2], &least.labelled, &least.unlabelled) == 8);
        const int32_t is_found = sweepd_find_obstacle(bytes, len, &zone, &least, &found);
        printf("{\"found\":%d", (int)is_found);
        if (is_found == 1)
            printf(",\"distance_m\":%.17g,\"returns\":%" PRIu32 ",\"label\":%" PRIu32, found.distance_m, found.returns, found.label);
        if (is_found < 0) say_text("error", sweepd_error());
        assert(sweepd_find_obstacle(bytes, len, &zone, &least, NULL) == is_found);
        if (least.labelled == 3 && least.unlabelled == 4) {
            sweepd_obstacle again;
            assert(sweepd_find_obstacle(bytes, len, &zone, NULL, &again) == is_found);
            assert(is_found != 1 || memcmp(&again, &found, sizeof found) == 0);
        }
        printf("}\n");
        fflush(stdout);
    }
    free(bytes);
    return 0;
}

static int wrong(void) {
    static const sweepd_zone box = {{-1.0, 0.0, 0.0}, {1.0, 5.0, 2.0}};
    static const uint64_t none[100];
    char text[8] = "before";
    size_t len = 7;
    sweepd_sample *sample = (sweepd_sample *)text;
    sweepd_client *client;
    assert(sweepd_abi_version() == SWEEPD_ABI_VERSION);
    assert(strcmp(sweepd_error(), "") == 0);
    assert(sweepd_client_open(NULL, NULL) == NULL && strstr(sweepd_error(), "NULL") != NULL);
    assert(sweepd_client_open("\xff\xfe", NULL) == NULL && strstr(sweepd_error(), "UTF-8") != NULL);
    assert(sweepd_client_objects(NULL) == NULL);
    assert(sweepd_client_next(NULL, 0, &sample) == SWEEPD_NEXT_FAILED && sample == NULL);
    assert(strstr(sweepd_error(), "client is NULL") != NULL);
    assert(sweepd_sample_bytes(NULL, &len) == NULL && len == 0 && sweepd_sample_bytes(NULL, NULL) == NULL);
    assert(sweepd_client_missed(NULL) == 0 && sweepd_client_reopened(NULL) == 0 && sweepd_client_has_next(NULL) == 0);
    assert(sweepd_client_is_connected(NULL) == 0 && sweepd_client_is_published(NULL) == 0);
    assert(sweepd_client_attribute(NULL, "model", text, sizeof text) == SIZE_MAX && strcmp(text, "before") == 0);
    assert(sweepd_sensors("/no/such", text, sizeof text) == 0 && strcmp(text, "") == 0);
    assert(sweepd_find_obstacle(none, sizeof none, NULL, NULL, NULL) == -1 && strstr(sweepd_error(), "zone is NULL") != NULL);
    assert(sweepd_find_obstacle(NULL, 0, &box, NULL, NULL) == -1 && strstr(sweepd_error(), "sweep are NULL") != NULL);
    assert(sweepd_find_obstacle(none, 7, &box, NULL, NULL) == -1 && strstr(sweepd_error(), "7 bytes") != NULL);
    assert(sweepd_find_obstacle(none, sizeof none, &box, NULL, NULL) == -1 && strstr(sweepd_error(), "magic") != NULL);
    sweepd_client_close(NULL);
    sweepd_sample_release(NULL);
    client = sweepd_client_open("roof", "/no/such");
    assert(client != NULL);
    assert(sweepd_client_next(client, 0, NULL) == SWEEPD_NEXT_FAILED);
    assert(sweepd_client_next(client, 0, &sample) == SWEEPD_NEXT_UNPUBLISHED && sample == NULL);
    assert(sweepd_client_attribute(client, NULL, NULL, 0) == SIZE_MAX);
    sweepd_client_close(client);
    printf("all refused\n");
    return 0;
}

int main(int argc, char **argv) {
    if (argc >= 5 && strcmp(argv[1], "talk") == 0) return talk(argv[2], argv[3], argv[4], argc == 6);
    if (argc == 4 && strcmp(argv[1], "watch") == 0) return watch(argv[2], argv[3]);
    if (argc == 3 && strcmp(argv[1], "obstacle") == 0) return obstacle(argv[2]);
    if (argc == 2 && strcmp(argv[1], "wrong") == 0) return wrong();
    return 1;
}
