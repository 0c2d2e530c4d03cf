#!/usr/bin/env bash
# All trainings and evaluations behind docs/results.md, one after the other: hours on two cores. Finished steps are
# skipped and interrupted ones resume when the same command is given again; a step that fails does not keep the others.
#
#     experiments/results.sh OUT DATA [GROUP...]    from the root of a checkout, with offpiste and the extra sim installed;
#                                                   OUT: folder of all results; DATA: folder of the recorded drives;
#                                                   GROUP: of steps, all by default. Most keep one core busy, so two
#                                                   commands with other groups go side by side; `controls` needs
#                                                   `laptop_figures` first, and `closed_loop` both.
set -euo pipefail
out=$(realpath -m "$1") data=$(realpath "$2")
mkdir -p "$out/logs" "$out/done"
failed=0
export OMP_NUM_THREADS=1

step() { # NAME COMMAND...: run once, with its output in OUT/logs/NAME.log
    local name=$1
    shift
    if [ -e "$out/done/$name" ]; then return; fi
    echo "$(date +%T) $name"
    if "$@" > "$out/logs/$name.log" 2>&1; then
        touch "$out/done/$name"
    else
        echo "failed: $(tail -n 1 "$out/logs/$name.log") ($out/logs/$name.log)"
        failed=1
    fi
}
train() { # DATASET RUN OPTION...: train, or resume
    local dataset=$1 run=$2
    shift 2
    step "train-$(basename "$dataset" .zarr)-$(basename "$run")" offpiste train "$dataset" --out "$run" --resume "$@"
}

laptop_figures() {
    step fig4 offpiste reproduce fig4 --size laptop --out "$out/laptop"
    step fig3 offpiste reproduce fig3 --size laptop --out "$out/laptop"
}

real_drive() {
    local drives=$data/tartandrive2/drives folder=$out/turnpike runs=() folds=() flat=()
    local turnpike=$drives/2023-10-26-14-42-35_turnpike_afternoon_fall meadows=2023-11-02-16-00-43_down_meadows
    mkdir -p "$folder"
    echo "$meadows test" > "$folder/parts.txt"
    step turnpike offpiste extract "$turnpike" --rig tartandrive2 --out "$folder/turnpike.zarr"
    step flat offpiste extract "$turnpike" --rig tartandrive2 --flat --out "$folder/flat.zarr"
    step meadows offpiste extract "$drives/$meadows" --rig tartandrive2 --split "drives:$folder/parts.txt" \
        --out "$folder/meadows.zarr"
    for model in b parametric; do
        for seed in 0 1 2; do
            train "$folder/turnpike.zarr" "$folder/$model-$seed" --model $model --seed $seed
            train "$folder/turnpike.zarr" "$folder/cv-$model-$seed" --model $model --seed $seed --folds 5
            train "$folder/flat.zarr" "$folder/flat-$model-$seed" --model $model --seed $seed
            runs+=("$folder/$model-$seed") folds+=("$folder/cv-$model-$seed") flat+=("$folder/flat-$model-$seed")
        done
    done
    step report offpiste evaluate "${runs[@]}" --dataset "$folder/turnpike.zarr" --out "$folder/report"
    step report-folds offpiste evaluate "${folds[@]}" --dataset "$folder/turnpike.zarr" --out "$folder/report-folds"
    step report-flat offpiste evaluate "${flat[@]}" --dataset "$folder/flat.zarr" --out "$folder/report-flat"
    step report-meadows offpiste evaluate "${runs[@]}" --dataset "$folder/meadows.zarr" --out "$folder/report-meadows"
}

visual_features() {
    local drives=$out/probe/drives
    step probe python -m experiments.probe --out "$out/probe" --flaw-worlds halter-ranch --flaw-seconds 60 --directions 2
    step pca offpiste fit-pca "$drives"/*-61.mcap --rig proving_ground --backbone filterbank --out "$out/pca.safetensors"
    step eight offpiste extract "$drives"/*.mcap --rig proving_ground --pca "$out/pca.safetensors" --out "$out/eight.zarr"
    step view-eight offpiste view "$out/eight.zarr" --out "$out/view-eight"
    step view-halter offpiste view "$drives/halter-ranch-62.mcap" --rig proving_ground --pca "$out/pca.safetensors" \
        --out "$out/view-halter"
    step sensor-faults python -m experiments.sensor_faults "$drives"/*-62.mcap
}

controls() {
    for name in oracle shift strata; do
        step "control-$name" python -m experiments.control_experiments $name --reproduction "$out/laptop" --out "$out/controls"
    done
}

closed_loop() {
    local runs=("$out"/laptop/runs/{parametric,b,dc}-{0,1,2} "$out"/controls/oracle/runs/df-{0,1,2})
    step closed-loop python -m experiments.closed_loop_table --runs "${runs[@]}" --pca "$out/laptop/pca.safetensors" \
        --test --out "$out/closed-loop"
    step faults python -m experiments.closed_loop_table --runs "$out/laptop/runs/dc-0" --pca "$out/laptop/pca.safetensors" \
        --faults --courses 1 --out "$out/faults"
}

all_speeds() {
    step evening offpiste reproduce fig4 --size evening --out "$out/evening"
    step evening-strata python -m experiments.control_experiments strata --reproduction "$out/evening" \
        --out "$out/evening-controls"
    step pretrained python -m experiments.pretrained_models --reproduction "$out/evening" \
        --controls "$out/evening-controls" --out "$out/pretrained"
}

half_contrast() {
    step half-contrast offpiste reproduce fig4 --size laptop --seconds 1080 150 450 --grip-contrast 0.5 --out "$out/half"
}

groups=(laptop_figures real_drive controls closed_loop all_speeds half_contrast visual_features)
for group in "${@:3}"; do
    [[ " ${groups[*]} " == *" $group "* ]] || { echo "no group '$group'; there are: ${groups[*]}" >&2; exit 2; }
done
if [ $# -gt 2 ]; then groups=("${@:3}"); fi
for group in "${groups[@]}"; do "$group"; done
exit $failed
