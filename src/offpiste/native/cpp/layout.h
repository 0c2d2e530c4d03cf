/* Rows of the workspace and sizes. Written by `python -m offpiste.dynamics.kernels.generate`; do not edit.
   See dynamics/kernels/layout.py. */
#define OFFPISTE_STATES 6
#define OFFPISTE_MOVED 10
#define OFFPISTE_HIDDEN 4
#define OFFPISTE_ROWS 47
#define OFFPISTE_NEXT 36
#define OFFPISTE_SPEED 3
#define OFFPISTE_NORMAL 14
#define OFFPISTE_UNKNOWN 46
#define OFFPISTE_FIRST_CONTROL 10
#define OFFPISTE_KNOWN_CONTROLS 4
#define OFFPISTE_LEARNED 24
#define OFFPISTE_LAG_CONSTANTS 11
#define OFFPISTE_FADE 10.0f
