/* Plays a file of recorded runs and prints a hash of what the servo answered; for sanitizers and emulators.
 *
 * The file holds runs one after the other: u32 size of the configuration, u32 size of the image, u32 ticks, then
 * these bytes (see td_replay.h). Exit code 1 for a file that is not so, or that the core refuses.
 */
#include <stdio.h>
#include <stdlib.h>

#include "td_bytes.h"
#include "td_replay.h"

static td_replay replay;

static uint8_t *take(FILE *file, size_t size)
{
    uint8_t *bytes = malloc(size > 0 ? size : 1);

    if (bytes != NULL && fread(bytes, 1, size, file) != size) {
        free(bytes);
        bytes = NULL;
    }
    return bytes;
}

/* One run, its answers added to the hash (FNV-1a). */
static int run(FILE *file, const uint8_t *head, uint64_t *hash)
{
    const size_t config_size = td_get_u32(head), image_size = td_get_u32(head + 4), ticks = td_get_u32(head + 8);
    uint8_t *config = take(file, config_size), *image = take(file, image_size);
    uint8_t *input = take(file, ticks * TD_REPLAY_IN), *output = malloc(ticks * TD_REPLAY_OUT);
    int failed = 1;
    size_t j;

    if (config && image && input && output &&
        td_replay_start(&replay, config, config_size, image, image_size)) {
        td_replay_run(&replay, input, ticks, output);
        for (j = 0; j < ticks * TD_REPLAY_OUT; j++)
            *hash = (*hash ^ output[j]) * UINT64_C(1099511628211);
        failed = 0;
    }
    free(config);
    free(image);
    free(input);
    free(output);
    return failed;
}

int main(int argc, char **argv)
{
    uint64_t hash = UINT64_C(14695981039346656037);
    uint8_t head[12];
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    int failed = file == NULL;

    while (!failed && fread(head, 1, sizeof head, file) == sizeof head)
        failed = run(file, head, &hash);
    if (file != NULL)
        fclose(file);
    printf("%016llx\n", (unsigned long long)hash);
    return failed;
}
