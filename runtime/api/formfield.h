/* Formfield: bounced light for worlds larger than memory. The C interface of the runtime.
 *
 * An engine opens a baked world (NAME.ffm), tells it every frame where the observer is and what light falls directly on
 * the surfaces around, and gets back the radiosity of those surfaces with all bounces, and the irradiance at any point.
 *
 * Units: metres (right-handed, y up), metres a second, W/m2 per colour channel (linear RGB), W/(m2 sr) for radiance.
 *   Radiosity is what leaves a surface; irradiance what arrives at one. A white screen of radiosity B has radiance B / pi.
 * Words: a *patch* is a piece of surface; a *node* a patch (level 0) or a cluster of nodes of the level below; a *tile*
 *   up to 256 consecutive nodes of one level. The tiles around the observer are *active*: each of their nodes has a
 *   *slot*, and keeps it while its tile is active. Lists by slot have holes: slots of no tile hold nothing of meaning.
 * Ownership: handles are the caller's to destroy, worlds before their device. Pointers that functions return belong to
 *   the world and say how long they are valid. Strings and arrays passed in are copied or only read during the call.
 * Threads: a device and its worlds are used by one thread at a time (any). Callbacks come on the calling thread. The
 *   library's own threads read, decode, put matrices together and, on the CPU, share the solver's work. All but those of
 *   the solver leave the frame's thread its core when they are woken: their policy is SCHED_BATCH where that of the thread
 *   that opened the world was SCHED_OTHER, else the same. On a machine whose cores are all at work a frame may still wait
 *   milliseconds for one; a thread that gives itself a real-time policy (SCHED_FIFO) after formfieldOpenWorld does not.
 * The frame path (formfieldFrame, formfieldRecord, formfieldSample, the setters and everything that only reads):
 *   allocates and frees nothing and waits for no file after formfieldOpenWorld, errors aside. formfieldFrame waits for
 *   the device that it runs on.
 * Errors: every function that can fail returns a FormfieldResult and leaves a line that says what is wrong, where, and
 *   what to do about it; formfieldError() returns it. Nothing is printed, nothing exits, no exception comes out.
 * Structures begin with their size: set it, or use the function that fills in the defaults, so that newer libraries know
 *   which fields an older program has.
 */
#ifndef FORMFIELD_H
#define FORMFIELD_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FORMFIELD_NO_SLOT 0xffffffffu
#define FORMFIELD_MAX_SLOTS 262144u

typedef enum FormfieldResult {
  FORMFIELD_OK = 0,
  FORMFIELD_ERROR_USAGE = 1,        /* an argument or a setting */
  FORMFIELD_ERROR_IO = 2,           /* a file cannot be read; a driver or a device fails */
  FORMFIELD_ERROR_INVALID_FILE = 3, /* a file is damaged or not a world */
  FORMFIELD_ERROR_PHYSICS = 4,      /* valid, but more light would come out than went in */
  FORMFIELD_ERROR_UNSUPPORTED = 5,  /* this device, or this build, cannot do it */
  FORMFIELD_ERROR_OUT_OF_MEMORY = 6
} FormfieldResult;

typedef struct FormfieldDevice_T* FormfieldDevice; /* where light is computed */
typedef struct FormfieldWorld_T* FormfieldWorld;   /* an open world, streamed around its observers */

/* Version of the library, major * 10000 + minor * 100 + patch, and as text. */
uint32_t formfieldVersion(void);
const char* formfieldVersionText(void);

/* The line of the last error of a device, of its worlds, or of formfieldCreate...Device on this thread (device: NULL).
 * Empty: none. Valid until the next error. */
const char* formfieldError(FormfieldDevice device);

/* ---- Devices ---- */

/* The cores of this machine. threads: 0 takes all. A Vulkan device: formfield_vulkan.h. */
FormfieldResult formfieldCreateCpuDevice(int32_t threads, FormfieldDevice* device);
/* NULL is allowed. Its worlds must be closed. */
void formfieldDestroyDevice(FormfieldDevice device);
/* "cpu", "vulkan: NAME". Valid as long as the device. */
const char* formfieldDeviceName(FormfieldDevice device);

/* ---- Worlds ---- */

typedef enum FormfieldSolver {
  FORMFIELD_SOLVER_AUTO = 0,        /* what is recommended beside the world (NAME.settings.json), with its radius_m,
                                       growth and max_patches for those that are left at their defaults; else gather,
                                       until the first formfieldSettle chooses by size and density of what is around.
                                       On Vulkan what records frames: a recommended gather or multibounce, else
                                       gather. Gather also where the device refuses what is recommended */
  FORMFIELD_SOLVER_GATHER = 1,      /* sparse iterations, warm-started: open worlds */
  FORMFIELD_SOLVER_MULTIBOUNCE = 2, /* one dense matrix with all bounces in it: small closed spaces */
  FORMFIELD_SOLVER_SEED = 3         /* the seed paper's method, for comparison */
} FormfieldSolver;

typedef enum FormfieldStorage { FORMFIELD_STORAGE_FLOAT32 = 0, FORMFIELD_STORAGE_FLOAT16 = 1 } FormfieldStorage;

typedef struct FormfieldWorldSettings {
  uint32_t size;               /* sizeof(FormfieldWorldSettings) */
  float radius_m;              /* within it light is computed patch by patch; beyond, ever coarser; 0: 16 patches' edges */
  float growth;                /* of the radius from level to level */
  float hysteresis;            /* tiles leave this factor farther away than they enter */
  uint64_t memory_bytes;       /* of strips in memory */
  uint64_t kept_bytes;         /* of these, of strips that are wanted no more: for the observer's return */
  uint32_t max_patches;        /* active at once */
  uint32_t max_nodes;          /* of all levels, up to FORMFIELD_MAX_SLOTS; where they run out, growth is smaller first, then the radius. A town of 1M takes 40,000 of an observer
                                * at rest and 125,000 of one at 60 m/s, so that what comes and goes does so over a long way: fewer make that shorter */
  uint32_t decode_threads;
  FormfieldSolver solver;
  FormfieldStorage storage;    /* of dense matrices */
  uint32_t dense_places;       /* nodes in a dense matrix, at most; its size is the square of it */
  uint32_t iterations;         /* of the solver, a frame; 0: what suits it (gather: 2, and 1 where no light has changed for 60 frames) */
  uint32_t probes;             /* for formfieldSample: points remembered; 0: formfieldSample is not used */
  uint32_t probe_rays;         /* of each */
  uint64_t probe_memory_bytes; /* of drawing triangles that rays of probes meet */
  uint32_t fade_frames;        /* over which light follows where finer and coarser surface take turns, at the fastest: they fade into each other, and light follows, by the observers'
                                  way (their velocities: one that is given as 0 while an observer moves makes it slow); 0: at once. What is needed is loaded so much earlier. A change of light is never held back. The seed baseline follows at once */
  uint32_t logged_frames;      /* the last so many frames are kept, 500 bytes each, for FormfieldStats and formfieldWriteTrace; 0: none */
  uint64_t hint_bytes;         /* of memory_bytes, at most, for what formfieldExpect names */
  uint64_t read_bytes_per_second; /* of strips, at most; 0: no limit. The nearest come first; the index (1 % of that) and the coarsest level come on top */
  uint32_t max_applied_tiles;  /* that enter a frame's matrix and light, at most, the nearest first; 0: no limit. The first frame, formfieldSettle, a re-bake and,
                                  rarely, slots that are given out anew take all at once */
  float reload_seconds;        /* so often the world's file is looked at (one stat; behind a web server, one request for a byte), and when it was
                                  baked again that is taken up, as by formfieldReload; 0, the default: only formfieldReload does */
  float fade_change;           /* of the mean of what surfaces near observers reflect: by no more does a surface's light follow, in a frame, what fade_frames hold back, twice the radius
                                  away or nearer, and farther away by so much times the cube of the distance, and of the surface's own light on top; but where an observer would be there before, it follows
                                  sooner. 0.01; 0: no limit. The seed baseline follows at once */
} FormfieldWorldSettings;

/* Good values for a world of 1 m patches. */
void formfieldDefaultWorldSettings(FormfieldWorldSettings* settings);

/* path: NAME.ffm, or its http:// or https:// address (formats/README.md). Opens it and loads its coarsest level. settings: NULL for the defaults. */
FormfieldResult formfieldOpenWorld(FormfieldDevice device, const char* path, const FormfieldWorldSettings* settings,
                                   FormfieldWorld* world);
/* Waits for reads that are under way. NULL is allowed. */
void formfieldCloseWorld(FormfieldWorld world);

/* Hot reload: opens the world's file anew, as it is now, after it was baked again. Returns at once. A thread of the library's own opens it, loads what is
 * around the observers and puts its matrix together, meanwhile with the memory and the threads of a second world; then one of the next frames changes
 * over (FormfieldStats::reloads), whole, and what it had before is let go. That frame waits for nothing, and asks for direct light as after formfieldLightChanged.
 * Light goes on node by node where there is the same node, else from its cluster; sky, direct light and, by their names, switches of lamp groups are kept,
 * and so are the solver and its settings. The state is that of a world just opened: from then on FormfieldWorldInfo, numbers of patches, tiles, slots and
 * lamp groups (and their names) are the new bake's. What cannot be opened, or is damaged around the observers, is left alone
 * (formfieldReloadFailure, FormfieldStats::reload_failures) and the world goes on as it was: call again, or with reload_seconds it is tried again
 * when the file changes, and every 5 s. Readers that are open go on with their own files. On Vulkan a bake that needs half as much again as the first one may fill the device. */
FormfieldResult formfieldReload(FormfieldWorld world);
/* Why the last attempt came to nothing, as a line; empty: it did not. Allocates; valid until the next call. */
const char* formfieldReloadFailure(FormfieldWorld world);

typedef struct FormfieldWorldInfo {
  uint32_t size;       /* sizeof(FormfieldWorldInfo) */
  uint32_t levels;
  uint64_t patches;    /* level-0 nodes; patch numbers are below */
  float cell_m;        /* edge of the grid that patches were cut by */
  double origin[3];    /* m, in the scene's world space: where all positions in floats count from; zero but for scenes that stand far away */
  float lo[3], hi[3];  /* bounds, from the origin */
  uint32_t has_geometry; /* 1: drawing triangles were baked in; probes need them */
  uint32_t lamp_groups;  /* see formfieldLampGroups */
  uint32_t preview;      /* 1: baked in seconds to look at (ffbake --preview): not to be shipped */
} FormfieldWorldInfo;

FormfieldResult formfieldGetWorldInfo(FormfieldWorld world, FormfieldWorldInfo* info);

/* ---- Light ---- */

/* Everything here is a finite number from 0 to 1e12 W/m2 (radiance: W/(m2 sr); a sky's gradient has either sign); below
 * 0 by less than 1e-3 it counts as rounding. The functions refuse anything else with FORMFIELD_ERROR_USAGE and a line
 * that names the slot, tile and node, and leave all as it was. What a callback returns is taken for zero and counted
 * instead (FormfieldStats::light_zeroed, formfieldLightFault): the frame goes on. Light that is not finite in spite of
 * all, or past 1e15 W/m2, is put right by the solver's next step, and counted as well (light_repaired). */

typedef struct FormfieldNode {
  float centroid[3], normal[3]; /* m; unit, or zero where a cluster's pieces cancel */
  float area_m2;
  float albedo[3];
} FormfieldNode;

/* Direct irradiance (sun, lamps of your own; not the sky, not what surfaces emit) of the nodes of one tile, W/m2, three floats a
 * node; of a cluster the area-weighted mean over its patches. Called from formfieldFrame when a tile becomes active and
 * after formfieldLightChanged. `irradiance` is zero beforehand. */
typedef void (*FormfieldDirectLight)(void* user, uint32_t level, uint32_t tile, uint64_t first_node, uint32_t nodes,
                                     const FormfieldNode* node, float* irradiance);

/* NULL: no direct light but what formfieldSetDirectIrradiance sets. */
FormfieldResult formfieldSetDirectLight(FormfieldWorld world, FormfieldDirectLight direct_light, void* user);
/* Asks for all active tiles anew at the next frame. */
FormfieldResult formfieldLightChanged(FormfieldWorld world);
/* Sets it for slots first .. first + count - 1 instead, three floats each, from the next frame on; stays until set
 * again, the callback is asked again, or the tile leaves. For callers that light by slot. */
FormfieldResult formfieldSetDirectIrradiance(FormfieldWorld world, uint32_t first, uint32_t count,
                                             const float* irradiance);

/* A sky of radiance L(w) = radiance[c] + dot(gradient[c], w) + sum over k of quadratic[c][k] P_k(w) for channel c and unit
 * direction w = (x, y, z), W/(m2 sr), with P = {2xy, 2yz, 2zx, (3y^2 - 1) / 2, x^2 - z^2}. All zero: no sky. */
typedef struct FormfieldSky {
  float radiance[3];
  float gradient[3][3];
  float quadratic[3][5];
} FormfieldSky;

FormfieldResult formfieldSetSky(FormfieldWorld world, const FormfieldSky* sky);

/* Surfaces that emit light are switched by *lamp group*: those of one material, or of what the scene names together. */
typedef struct FormfieldLampGroup {
  const char* name;  /* valid until the world is closed, or a re-bake taken up */
  float emission[3]; /* as baked, W/m2: the largest of its patches, a channel at a time */
  float area_m2;
  uint32_t patches;
} FormfieldLampGroup;

/* The world's lamp groups first .. first + count - 1; FormfieldWorldInfo::lamp_groups says how many there are. */
FormfieldResult formfieldLampGroups(FormfieldWorld world, uint32_t first, uint32_t count, FormfieldLampGroup* groups);
/* The number of the group of that name. FORMFIELD_ERROR_USAGE: there is none. */
FormfieldResult formfieldFindLampGroup(FormfieldWorld world, const char* name, uint32_t* group);
/* From the next frame on a lamp group emits scale[c] times what was baked: {0, 0, 0} switches it off, {1, 1, 1} brings the
 * same light back, to the bit, others dim and colour it. Finite, >= 0. Its light changes at every level of the cut at once
 * and bounces from the next frame on; nothing is loaded and formfieldLightChanged need not be called. As cheap as a new
 * sky, so a lamp may flicker. */
FormfieldResult formfieldSetEmission(FormfieldWorld world, uint32_t group, const float scale[3]);

/* ---- Frames ---- */

/* One frame: hands over where the observer is, to a thread of the library's own that asks for what is missing there and for what the path will need (it is foretold
 * by `velocity`, m/s, and how that turns), takes up what that has found for the frame before, and the newest cut whose matrix is ready, which another thread puts together, and iterates. On a Vulkan device it submits and waits; formfieldRecord
 * (formfield_vulkan.h) does the same into the caller's command buffer. observer: m, in the scene's own world space, however far from its
 * zero that is; all positions that are floats count from FormfieldWorldInfo::origin. */
FormfieldResult formfieldFrame(FormfieldWorld world, const double observer[3], const float velocity[3]);

#define FORMFIELD_MAX_OBSERVERS 16u
typedef struct FormfieldObserver {
  double position[3]; /* m, as above */
  float velocity[3];  /* m/s */
} FormfieldObserver;

/* The same for several observers of one world (players side by side, an editor's views): they share its strips, memory, threads and slots, and
 * what one has around it is there for all. Each keeps its place in the list from frame to frame. The budgets of FormfieldWorldSettings are of all
 * together. */
FormfieldResult formfieldFrameFor(FormfieldWorld world, uint32_t count, const FormfieldObserver* observers);

/* Where an observer will be otherwise than by its velocity: after a teleport, a cut scene, at a spawn point. */
typedef struct FormfieldPlace {
  double position[3]; /* m, as an observer's */
  float seconds;      /* from now, >= 0 */
} FormfieldPlace;

/* From the next frame on what such places want is read ahead, the soonest first, each from the nearest on, within hint_bytes: what fits and can be read in time is
 * there when an observer jumps. Replaces all that was expected before; count: 0 to FORMFIELD_MAX_OBSERVERS. A place is forgotten 5 s after its time. Call it
 * once, or with every frame. The budgets of an observer hold for what is wanted once it is there: max_patches, max_nodes. */
FormfieldResult formfieldExpect(FormfieldWorld world, uint32_t count, const FormfieldPlace* places);

/* Radiosity by slot after the last formfieldFrame, W/m2: red, green, blue and one float without meaning. Valid until the
 * next frame. What slots show is made when it is first asked for after a frame, which takes time for each slot: a frame whose light nobody asks for does without. */
const float* formfieldRadiosity(FormfieldWorld world, uint32_t* slots);

/* Irradiance, W/m2, of a small surface at each point that faces along its normal (of any length): what surfaces around
 * reflect and emit, and the sky; not the caller's direct light. For characters and all else that moves. points,
 * normals, irradiance: three floats each. Points near the observer are answered best. Walls keep light out. Remembered
 * points are cheap; new ones cost probe_rays rays, and up to 144 where surfaces that emit are near. Changes with the last
 * frame's light. A point that is not finite, or a normal that is not or that is zero, is answered with zero and counted
 * (FormfieldStats::samples_refused). */
FormfieldResult formfieldSample(FormfieldWorld world, uint32_t count, const float* points, const float* normals,
                                float* irradiance);

/* Loading screens, tests: blocks until nothing is left to load for the last observer and the light changes by less than
 * tolerance (of the largest radiosity) from one iteration to the next, or max_iterations are done: FormfieldStats says
 * which (settled) and what is undone (settle_change). */
FormfieldResult formfieldSettle(FormfieldWorld world, float tolerance, uint32_t max_iterations);

/* ---- Which slot is what ---- */

typedef struct FormfieldTile {
  uint32_t level, tile; /* number within the level, of this bake */
  int32_t chunk[3];     /* the tile's name: its chunk, a cube of 32 cells of its level, and its number within that; the same */
  uint32_t chunk_tile;  /* from bake to bake where nothing in the chunk changed */
  uint32_t first_slot;  /* slots of a tile are consecutive, in the order of its nodes */
  uint64_t first_node;  /* number within the level */
  uint32_t nodes;
} FormfieldTile;

/* The active tiles, sorted by (level, tile). Valid until the next frame. change (may be NULL): differs from its last
 * value whenever the tiles or their slots do. */
const FormfieldTile* formfieldTiles(FormfieldWorld world, uint32_t* count, uint64_t* change);
/* Slot that lights a patch: its own, or that of the cluster that stands for it. Writes FORMFIELD_NO_SLOT before the first
 * frame. Patches first .. first + count - 1. May read the index of places where the observer was not yet, and keeps it. */
FormfieldResult formfieldPatchSlots(FormfieldWorld world, uint64_t first, uint32_t count, uint32_t* slots);
/* Level and node of a slot. FORMFIELD_ERROR_USAGE for a slot of no tile. */
FormfieldResult formfieldSlotNode(FormfieldWorld world, uint32_t slot, uint32_t* level, uint64_t* node);

/* ---- Statistics ---- */

typedef struct FormfieldStats {
  uint32_t size;                               /* sizeof(FormfieldStats) */
  uint32_t slots, leaves, level0_leaves;       /* leaves: nodes of the cut */
  uint64_t entries;                            /* of the local matrix */
  uint32_t cut_changed;                        /* in the last frame: 0 or 1 */
  double stream_ms, matrix_ms, solve_ms;       /* of the last frame; solve_ms on the device's clock */
  uint64_t strips_read, bytes_read, strips_evicted, reads_cancelled, strips_failed;
  uint64_t resident_bytes, peak_resident_bytes;
  uint32_t resident_tiles, wanted_tiles, pending_tiles; /* as found for the frame before; after a jump something is pending until its place was looked at */
  uint32_t fallbacks;                          /* 1: the device was lost or full, the CPU has taken over */
  double residual;                             /* of the last frame's light: largest |M + rho F B - B| over the largest B, on some rows, looked at when it is asked for;
                                                  (B: what surfaces reflect); negative: not measured. What fade_frames hold back counts. formfieldRecord measures multibounce only, all
                                                  leaves, before the last step of the frame frames_in_flight ago */
  uint32_t dense_nodes, dense_waiting;         /* leaves in the dense matrix, leaves that wait for it (lit all the same) */
  uint64_t dense_refused, dense_rebuilds;      /* blocks that could not enter with correct digits; matrices built anew */
  double dense_probe;                          /* error of the dense matrix, probed with random vectors; 0: not yet */
  uint64_t probes_traced, probes_remembered;   /* points answered by new rays, by remembered ones */
  uint32_t probe_tiles;                        /* level-0 tiles whose triangles are loaded */
  uint32_t settled;                            /* 1: the last formfieldSettle reached its tolerance */
  uint32_t settle_iterations;                  /* that it took */
  double settle_change;                        /* by its last iteration, over the largest radiosity */
  uint64_t light_zeroed;                       /* callbacks' values that were no light, taken for zero */
  uint64_t light_repaired;                     /* solver's values that were not finite or past 1e15 W/m2 */
  uint64_t samples_refused; /* points answered with zero: they or their normals are not finite, or 0 */
  double frame_ms_p50, frame_ms_p99, frame_ms_max; /* of the frames that are kept: what formfieldFrame or formfieldRecord took but for the solver's steps; half of them at most, ... */
  uint32_t late_tiles, ahead_tiles;            /* wanted and not there yet; read ahead, or on the way, for where the observers will be */
  uint32_t applied_tiles, waiting_tiles;       /* entered in the last frame; loaded, and kept back by max_applied_tiles */
  uint64_t reads_held;                         /* reads that began later than they could have, for read_bytes_per_second */
  uint32_t reloads, reload_failures;           /* re-bakes that were taken up; attempts that failed, each with another line */
  uint64_t reads, gap_bytes;                   /* reads of strips: those that lie beside each other share one; bytes between strips that these brought */
  uint64_t uploaded_row_bytes, uploaded_light_bytes; /* to a Vulkan device, since the start: of what entered its rows; sources and what else is by slot. All of
                                                        these where the light changes, or the whole cut */
  double decode_ms;                            /* of the decoding threads' time, since the start */
  uint64_t peak_stored_bytes;                  /* of strips that were read and not decoded yet, at most */
  float reached_radius_m, reached_growth;      /* radius_m and growth that the last frame's budgets had room for: those asked for, or less (formfieldBudgetWarning) */
  double frame_ms;                             /* what the last formfieldFrame or formfieldRecord took but for the solver's steps */
} FormfieldStats;

FormfieldResult formfieldGetStats(FormfieldWorld world, FormfieldStats* stats);
/* The frames that are kept (FormfieldWorldSettings::logged_frames) as a file for chrome://tracing or ui.perfetto.dev: what each frame's thread did, how its
 * tiles stood and where the observers were. `ffinspect trace WORLD FILE` flies the same path again. Allocates and waits for the file. */
FormfieldResult formfieldWriteTrace(FormfieldWorld world, const char* path);
/* "cpu", "vulkan: NAME": what computes the light now. Valid until the next frame. */
const char* formfieldSolverName(FormfieldWorld world);
/* Why this solver: empty before it is settled. */
const char* formfieldSolverReason(FormfieldWorld world);
/* Why the CPU has taken over; empty: it has not. Allocates nothing. */
const char* formfieldFallbackReason(FormfieldWorld world);
/* The last value of a callback that was taken for zero, as a line; empty: none. Valid until the next frame. */
const char* formfieldLightFault(FormfieldWorld world);
/* The last strip that could not be read (or whether probes lacked memory for triangles), as a line; empty: none. Allocates; valid until the next
 * call. */
const char* formfieldStreamFailure(FormfieldWorld world);
/* That a budget (max_nodes, max_patches, memory_bytes) ran out, so that full resolution ends nearer to the observers than radius_m asks for or coarser levels do: where that was
 * first, and what there was room for, as a line with its remedy. What is nearest has the room; FormfieldStats::reached_radius_m goes on. Empty: none did. Allocates; valid until the next call. */
const char* formfieldBudgetWarning(FormfieldWorld world);
/* What is wrong with where the world lies without being an error, as a line with its remedy: that what is read over http is not kept, since its folder cannot be
 * used (FORMFIELD_CACHE). Empty: nothing. Allocates; valid until the next call. */
const char* formfieldStorageWarning(FormfieldWorld world);

#ifdef __cplusplus
}
#endif
#endif
