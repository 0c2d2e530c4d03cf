/* Sampled controls moved into bounds and rates, in place: controls.keep_within, an item for each sample and control.
   controls: [steps, count, samples], items = count * samples. bounds: low, high, largest change of a step and control
   before the first, [4, count]; a control before that is NaN leaves the first step free. NaN stays, and spreads to all
   later steps. */
OFFPISTE_KERNEL(offpiste_keep_within, float* controls, const float* bounds, int count, int steps, int items) {
    OFFPISTE_EACH(i, items) {
        const int u = i / (items / count);
        const float low = bounds[u], high = bounds[count + u], change = bounds[2 * count + u];
        float before = bounds[3 * count + u];
        int is_free = !(before == before);
        before = before < low ? low : before;
        before = before > high ? high : before;
        for (int t = 0; t < steps; t++) {
            float value = controls[t * items + i];
            value = value < low ? low : value;
            value = value > high ? high : value;
            if (!is_free) {
                const float least = before - change, most = before + change;
                value = value < least ? least : value;
                value = value > most ? most : value;
                value = before == before ? value : before;
            }
            is_free = 0;
            controls[t * items + i] = before = value;
        }
    }
}
