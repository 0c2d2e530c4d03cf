/* Drives the model over the map and the controls of a parity file, prints the states of the first drive, and compares
   all drives with what offpiste predicts.

       cc -std=c99 -O2 example.c -o example -lm && ./example parity.bin */
#include "offpiste.h"
#include "parity.h"

int main(int count, char** arguments) {
    const offpiste_parity p = offpiste_read_parity(count > 1 ? arguments[1] : "parity.bin");
    float* codes = offpiste_code_cells(&p);
    const offpiste_map map = offpiste_map_of(&p, codes);
    float* states = (float*)malloc(sizeof(float) * 10 * p.drives * p.steps);
    int drive, t, failed;
    if (!states) return 1;
    for (drive = 0; drive < p.drives; drive++) {
        float state[OFFPISTE_STATE];
        offpiste_given given;
        offpiste_start_of(&p, &map, drive, state);
        for (t = 0; t < p.steps; t++) {
            const int at = drive * p.steps + t;
            memcpy(given.control, p.control + p.controls * at, sizeof given.control);
            offpiste_look(&map, state, &given);
            offpiste_step(&offpiste_model, &given, state);
            memcpy(states + 10 * at, state, 10 * sizeof(float));
        }
    }
    failed = offpiste_report(&p, states);
    free(states), free(codes), free(p.content);
    return failed;
}
