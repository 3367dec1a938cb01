/* consumer WORLD.ffm: walks through a baked world, lights it, and prints what an engine would use. */
#include <formfield.h>
#include <math.h>
#include <stdio.h>

/* Direct light: a lamp of 500 W at `user`, without shadows (an engine has its own). Inverse squares, Lambert's cosine. */
static void lamp(void* user, uint32_t level, uint32_t tile, uint64_t first_node, uint32_t nodes, const FormfieldNode* node,
                 float* irradiance) {
  const float* at = user;
  (void)level, (void)tile, (void)first_node;
  for (uint32_t i = 0; i < nodes; ++i) {
    const float d[3] = {at[0] - node[i].centroid[0], at[1] - node[i].centroid[1], at[2] - node[i].centroid[2]};
    const float d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + 0.01f;
    const float cosine =
        (d[0] * node[i].normal[0] + d[1] * node[i].normal[1] + d[2] * node[i].normal[2]) / sqrtf(d2);
    for (int c = 0; c < 3; ++c) irradiance[3 * i + c] = cosine > 0 ? 500 / (4 * 3.14159265f * d2) * cosine : 0;
  }
}

static int fail(FormfieldDevice device, const char* what) {
  fprintf(stderr, "consumer: %s: %s\n", what, formfieldError(device));
  return 2;
}

static int run(FormfieldDevice device, FormfieldWorld world) {
  FormfieldWorldInfo info;
  info.size = sizeof info;
  if (formfieldGetWorldInfo(world, &info) != FORMFIELD_OK) return fail(device, "world");
  printf("%llu patches of %g m on %u levels\n", (unsigned long long)info.patches, info.cell_m, info.levels);

  double at[3]; /* in the scene's world space; what is a float counts from the origin */
  float lamp_at[3];
  for (int a = 0; a < 3; ++a) at[a] = info.origin[a] + (lamp_at[a] = 0.5f * (info.lo[a] + info.hi[a]));
  const FormfieldSky sky = {{0.9f, 1.15f, 1.5f}, {{0, 0.1f, 0}, {0, 0.3f, 0}, {0, 0.6f, 0}}, {{0}}};
  formfieldSetSky(world, &sky);
  formfieldSetDirectLight(world, lamp, lamp_at);

  /* An engine's frames. Nothing waits: light sharpens as strips arrive. */
  const float velocity[3] = {3, 0, 0};
  for (int frame = 0; frame < 60; ++frame) {
    at[0] += velocity[0] / 60.0;
    if (formfieldFrame(world, at, velocity) != FORMFIELD_OK) return fail(device, "frame");
  }
  if (formfieldSettle(world, 1e-4f, 500) != FORMFIELD_OK) return fail(device, "settle"); /* a loading screen's way */

  /* For surfaces: radiosity by slot, and the slot of each patch. */
  uint32_t slots = 0, slot = FORMFIELD_NO_SLOT;
  const float* radiosity = formfieldRadiosity(world, &slots);
  if (formfieldPatchSlots(world, info.patches / 2, 1, &slot) != FORMFIELD_OK) return fail(device, "slots");
  printf("patch %llu is lit by slot %u of %u: %g %g %g W/m2\n", (unsigned long long)(info.patches / 2), slot, slots, radiosity[4 * slot],
         radiosity[4 * slot + 1], radiosity[4 * slot + 2]);

  /* For characters: irradiance where they stand, from above and from one side. */
  float points[6];
  const float normals[6] = {0, 1, 0, 1, 0, 0};
  for (int a = 0; a < 3; ++a) points[a] = points[3 + a] = (float)(at[a] - info.origin[a]);
  float irradiance[6];
  if (formfieldSample(world, 2, points, normals, irradiance) != FORMFIELD_OK) return fail(device, "sample");
  printf("irradiance from above %g %g %g, from the side %g %g %g W/m2\n", irradiance[0], irradiance[1], irradiance[2],
         irradiance[3], irradiance[4], irradiance[5]);

  FormfieldStats stats;
  stats.size = sizeof stats;
  if (formfieldGetStats(world, &stats) != FORMFIELD_OK) return fail(device, "stats");
  printf("%s: %u leaves (%u patches), %llu entries, residual %.1e; %llu strips read, %llu KiB resident, %u pending\n",
         formfieldSolverName(world), stats.leaves, stats.level0_leaves, (unsigned long long)stats.entries, stats.residual,
         (unsigned long long)stats.strips_read, (unsigned long long)(stats.resident_bytes >> 10), stats.pending_tiles);
  return irradiance[1] > 0 && stats.level0_leaves > 0 && stats.pending_tiles == 0 && stats.residual < 1e-3 ? 0 : 3;
}

int main(int argc, char** argv) {
  if (argc != 2) return fprintf(stderr, "usage: consumer WORLD.ffm\n"), 1;
  printf("Formfield %s\n", formfieldVersionText());
  FormfieldDevice device;
  if (formfieldCreateCpuDevice(0, &device) != FORMFIELD_OK) return fail(NULL, "device");
  FormfieldWorldSettings settings;
  formfieldDefaultWorldSettings(&settings);
  settings.radius_m = 16;
  FormfieldWorld world;
  int code = 2;
  if (formfieldOpenWorld(device, argv[1], &settings, &world) == FORMFIELD_OK) {
    code = run(device, world);
    formfieldCloseWorld(world);
  } else {
    fail(device, argv[1]);
  }
  formfieldDestroyDevice(device);
  return code;
}
