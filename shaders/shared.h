// Constants and structs that C++ and GLSL share; both compilers read this file, so a layout is written down once.
// Only 4-byte scalars and vec4/mat4 (16-byte aligned members): std430, push constants and C++ then agree byte for byte.
#ifndef FF_SHADERS_SHARED_H_
#define FF_SHADERS_SHARED_H_

#ifdef __cplusplus
#include <cstdint>
namespace ff::shaders {
using uint = uint32_t;
struct alignas(16) vec4 {
  float x = 0, y = 0, z = 0, w = 0;
};
struct alignas(16) mat4 {
  float m[16] = {};  // column-major
};
#define FF_CONST inline constexpr
#else
#define FF_CONST const
#endif

// Radiosity, W/m2, that a solver may hold: runtime/solver/sound_light.h's limit of a caller's light, in a room that keeps all
// but a thousandth. Its square times 65536 is still a number.
FF_CONST float kMaxRadiosity = 1e15f;

// --- gather*.comp, pace*.comp, ease.comp, fade.comp, resolve.comp, refine.comp: the sparse local matrix; runtime/gather/vk_gather.cpp ---
FF_CONST uint kGatherGroup = 64u;       // invocations of a work group: 64 / subgroup size rows at once
FF_CONST uint kRefineGroup = 64u;
FF_CONST uint kEntriesPerLoad = 4u;     // rows are padded to whole uvec4
FF_CONST uint kCountBits = 14u;         // of an entry of a row: column slot << kCountBits | count
FF_CONST uint kCountMask = (1u << kCountBits) - 1u;
FF_CONST uint kPageNodes = 256u;        // columns of a page of the page table
FF_CONST uint kPageWords = 1u + kPageNodes / 4u;  // of a page: the first slot, and each column's number from there on, four to a word
FF_CONST uint kNodeWords = 7u;          // of a packed tile: albedo r, g, b, area, 1 / Q, parent's slot, next sibling's
FF_CONST uint kPlaceWords = 7u;         // at the end of a packed tile: what bounds it, lowest x, y, z and highest, m; its level
FF_CONST uint kTopSlot = 0xffffffffu;   // for a parent's slot: there is none
FF_CONST uint kFreeSlot = 0xfffffffeu;  // the slot itself is free
FF_CONST uint kFree = 0u;               // kinds of slots
FF_CONST uint kLeaf = 1u;
FF_CONST uint kRefined = 2u;

// A slot's row among the resolved entries.
struct GatherRow {
  uint first;    // in uvec4 from the start of the segment
  uint entries;
  uint segment;  // of the entries: what one binding holds
  float scale;   // 1 / Q
};
// A tile to take up or to resolve. Its words in the packed buffer: run_start and row_start (nodes + 1 each), the nodes, the
// runs (words << 16 | partner), the page of each partner, 16-bit words (column << 8 | count), two to a word; then its place.
struct TileJob {
  uint first_slot;
  uint nodes;
  uint segment;
  uint packed_at;   // word of the packed buffer
  uint pages_at;    // from packed_at
  uint words_at;    // from packed_at
  uint entries_at;  // uvec4 of the segment
  uint start;       // radiosity of its nodes: kStartKept ...
};
FF_CONST uint kStartKept = 0u;
FF_CONST uint kStartParent = 1u;  // the parent's; from zero at the top level
FF_CONST uint kStartZero = 2u;
FF_CONST uint kStartEased = 3u;   // the parent's irradiance on their own albedo, in either buffer

// Light held back (Solver::ease) that is found to be larger than so many times itself takes its full time again.
FF_CONST float kHeldGrown = 1.05f;

struct JobPush {
  uint first;  // job
  uint count;  // jobs; slots in gather_kinds.comp
  uint groups; // work groups a job; the pass in gather_kinds.comp
};
struct GatherPush {
  uint slots;
  uint segment;
  float omega;   // of a step that goes further
  uint frames;   // that what is held back takes to go, where it is found
};
// gather_change.comp
struct ChangePush {
  uint slots;
};
// pace.comp, pace_limit.comp, ease.comp: how fast what is held back goes (runtime/solver/light_pace.h)
FF_CONST uint kMostObservers = 16u;
FF_CONST uint kMostLevels = 16u;
FF_CONST float kNoLimit = 1e30f;
struct PaceFrame {
  vec4 at[kMostObservers], way[kMostObservers];  // where observers are, and how they move in a frame, nowhere 0; m
  float radii_m[kMostLevels];
  uint observers;
  float near_m, at_hand_m;
  float fewest_frames;  // that what is due takes
  float most_change;  // of the mean
};
struct TilePace {
  float loosened;  // so many times the limit holds
  float due;       // of what is held back, at least so much goes in this frame
};
struct PacedLight {  // of a tile's leaves, as far as it counts for the mean
  float light, area_m2;  // W
};
struct EaseState {
  float most;         // by so much a slot's light follows in a frame, W/m2; kNoLimit: no matter how much
  uint last_holding;  // the last record after which anything was held back still
};
struct PacePush {
  uint tiles;
};
struct EasePush {
  uint slots;
  uint along;    // 1: radiosity goes along
  uint frames;   // that what is held back takes to go
  uint record;   // number of this one
  float most_change;  // PaceFrame::most_change, which paces and EaseState::most are for; 0: there is no limit
};
// Consecutive slots. Those with one parent name each other in a ring (LocalMatrix::next_sibling), all within the span.
struct SlotSpan {
  uint first_slot;
  uint slots;
  uint place_at;  // of a tile: word of the packed buffer
};
// Consecutive slots whose tile fades out.
struct FadingSlots {
  uint first_slot;
  uint slots;
  float own;  // of what they show, so much is their own; the rest is what their parents show
};
struct FadePush {
  uint record;  // that the weights count for
};
struct ShinePush {
  uint slots;
  uint stepped;  // 1: a step was made with these sources
  uint fades;    // weights of this record count; 0: nothing fades
};
struct RefinePush {
  uint first;   // span
  uint groups;  // work groups a span
};

// --- bounce_*.comp: the dense multi-bounce matrix; runtime/dense/vk_multibounce.cpp has the formulas ---
FF_CONST uint kBounceGroup = 128u;  // invocations; kFoldGroup for bounce_fold.comp
FF_CONST uint kBounceBlock = 64u;   // nodes that enter or leave in one step, at most
FF_CONST uint kBounceTile = 64u;    // matrices are padded to whole tiles of 64 x 64
FF_CONST uint kFoldGroup = 64u;     // 8 x 8 invocations, 8 x 8 elements each
FF_CONST uint kFoldDepth = 16u;     // of the factors in shared memory at once
FF_CONST uint kBounceRows = 4u;     // rows that a subgroup multiplies at once, so that the vector is loaded once for all
FF_CONST uint kBounceMean = 3u;     // BouncePush::channel of a matrix for the mean of the channels
FF_CONST uint kNotInBlock = 0xffffffffu;
FF_CONST uint kSpoiltPrecision = 1u;  // why a matrix has to be cleared: nodes could not leave it; it is not finite
FF_CONST uint kSpoiltNotFinite = 2u;
FF_CONST float kHalfMatrixScale = 8.0f;  // fp16 matrices hold 8 times the value: normal numbers from 7.6e-6 to 8191

// Words of the buffer that describes a block.
FF_CONST uint kBlockPlaces = 0u;          // kBounceBlock
FF_CONST uint kBlockAlbedo = 64u;         // channel by channel, the mean last: 4 * kBounceBlock floats
FF_CONST uint kBlockRowStart = 320u;      // kBounceBlock + 1
FF_CONST uint kBlockColumnStart = 385u;   // kBounceBlock + 1
FF_CONST uint kBlockIndex = 512u;         // per place its number in the block, or kNotInBlock; then pairs (place, value)

struct BouncePush {
  uint stride;      // places, rounded up to whole tiles
  uint used;        // places below it may be in use; a multiple of kBounceTile
  uint k;           // nodes of the block
  uint channel;     // kBounceMean: one matrix for all
  uint bound;       // the channel's number among the albedos and vectors that are bound: 0 where only its own are
  uint leaving;     // 0: the block enters, 1: it leaves
  uint columns_at;  // word of the first pair of F_LP in the block's buffer
  uint first, end;  // columns to fold in; columns that are pending
  uint pending;     // 1: the factors still count
  uint x_at;        // floats from the start of a channel's vectors: what is multiplied
  uint next_at;     // what luminance multiplies next; 0: nothing
  uint count;       // entries, places: see the shader
};
// bounce_residual.comp, bounce_correct.comp: a recorded step; runtime/dense/vk_dense_step.cpp
struct CorrectPush {
  uint stride;  // places, as above
  uint slots;
  uint first;  // 1: the first step of a frame
};
struct StepSums {               // over the leaves of a work group
  float left, norm;             // |B' - B|^2, |B' - M|^2
  float largest_left, largest;  // |B' - B|, B' of any channel
  uint relit;                   // not 0: M is not that of the last frame
};

// --- seed_*.comp: the seed paper's eight shaders; runtime/cpu_seed.h has the equations ---
FF_CONST uint kSeedGroup = 128u;
FF_CONST uint kSeedColumns = 16u;  // of seed_row.comp's work group, side by side: 128 bytes of a row
FF_CONST uint kSeedRows = 8u;      // of seed_outer.comp's work group
// Vectors of `stride` vec4, by number.
FF_CONST uint kSeedDoubleColumn = 0u;  // g_col
FF_CONST uint kSeedDoubleRow = 1u;     // g_row
FF_CONST uint kSeedColumn = 2u;        // the new patch's column and row of the matrix
FF_CONST uint kSeedRow = 3u;
FF_CONST uint kSeedColour = 4u;
FF_CONST uint kSeedLight = 5u;
FF_CONST uint kSeedIrradiance = 6u;
FF_CONST uint kSeedDouble = 7u;  // one vec4: double_reflection

struct SeedPush {
  uint stride;  // elements of a row of the matrix
  uint used;    // places in use lie below it
  uint place;   // of the patch that enters or leaves
  uint forms;   // float at which the patch's f_row begins; f_col follows after `stride`
  float red, green, blue;  // its colour
};

// --- pictures: interpolate.comp, sun.vert/.frag, count.comp, surface.vert/.frag, sky.vert/.frag ---
FF_CONST uint kInterpolateGroup = 64u;
FF_CONST uint kCountGroup = 64u;
FF_CONST uint kInterpolated = 8u;  // patches that light a vertex, at most
FF_CONST uint kShadowMaps = 2u;    // around the eye; the whole world

// Which patches light a vertex, weights sum to 1; unused ones have weight 0.
struct Interpolation {
  uint patches[kInterpolated];
  float weights[kInterpolated];
};
// Irradiance, W/m2, of a vertex. The sun is not in it: it is found per pixel.
struct Light {
  vec4 direct;   // straight from lamps and sky
  vec4 bounced;  // the same, and from all surfaces after any number of bounces
};
struct PatchLook {
  vec4 albedo;
  vec4 emission;  // W/m2
  vec4 direct;    // irradiance from lamps, lights of the file and sky, W/m2
};
struct PatchFigures {
  float difference;    // to the full-world solve
  float sun_exposure;  // mean over the patch of the cosine where the sun is seen
};
struct InterpolatePush {
  uint first;  // vertex
  uint count;
};
struct CountPush {
  uint texels;
};
struct SunPush {
  mat4 projection;
  float back_face_depth;  // how far back faces are moved away from the sun, in depth units
};
struct Frame {
  mat4 view_projection;
  mat4 shadow[kShadowMaps];  // world to shadow map: x, y in texels, z depth
  vec4 shadow_texel_m;       // per map
  vec4 shadow_bias;          // per map, depth units
  vec4 sun_direction;        // towards the sun
  vec4 sun_irradiance;       // on a surface that faces it, W/m2; all 0: no sun
  vec4 sky_l0;               // radiance
  vec4 sky_l1[3];            // gradient of each channel
  vec4 sky_l2[5];            // quadratic parts: runtime/sky.h
  vec4 eye;
  vec4 look_x, look_y, look_z;  // direction through the picture's centre (z) and half-extents (x right, y down)
  vec4 size;                 // x, y: pixels; z: shadow map texels
};

#ifdef __cplusplus
}  // namespace ff::shaders
#endif
#endif
