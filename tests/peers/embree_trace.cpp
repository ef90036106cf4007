// Embree's side of embree_trace.py, which documents the file and the lines.
//
//     embree_trace FILE medium|high

#include <embree3/rtcore.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <vector>

static RTCRay ray_of(const float* r, const float* direction, float t_far)
{
  RTCRay ray = {};
  ray.org_x = r[0], ray.org_y = r[1], ray.org_z = r[2];
  ray.dir_x = direction[0], ray.dir_y = direction[1], ray.dir_z = direction[2];
  ray.tfar = t_far;
  ray.mask = -1;
  return ray;
}

int main(int argc, char** argv)
{
  if (argc != 3)
    return std::fputs("usage: embree_trace FILE medium|high\n", stderr), 2;
  std::ifstream file(argv[1], std::ios::binary);
  unsigned counts[2];
  if (!file.read(reinterpret_cast<char*>(counts), sizeof counts))
    return std::fprintf(stderr, "%s: cannot be read\n", argv[1]), 1;
  std::vector<float> corners(size_t(counts[0]) * 9), rays(size_t(counts[1]) * 9);
  file.read(reinterpret_cast<char*>(corners.data()), corners.size() * sizeof(float));
  file.read(reinterpret_cast<char*>(rays.data()), rays.size() * sizeof(float));
  if (!file)
    return std::fprintf(stderr, "%s: ends early\n", argv[1]), 1;

  RTCDevice device = rtcNewDevice("threads=1");
  RTCScene scene = rtcNewScene(device);
  // High splits triangles in space; medium is Embree's default.
  rtcSetSceneBuildQuality(scene, argv[2][0] == 'h' ? RTC_BUILD_QUALITY_HIGH : RTC_BUILD_QUALITY_MEDIUM);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), counts[0] * 3);
  std::memcpy(vertices, corners.data(), corners.size() * sizeof(float));
  auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), counts[0]));
  for (unsigned i = 0; i < counts[0] * 3; i++)
    indices[i] = i;
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene, geometry);
  rtcCommitScene(scene);

  std::cout << "ready" << std::endl;
  std::string line;
  while (std::getline(std::cin, line)) {
    unsigned hits = 0;
    double sum = 0;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    auto start = std::chrono::steady_clock::now();
    if (line == "closest") {
      for (size_t i = 0; i < counts[1]; i++) {
        RTCRayHit query = {};
        query.ray = ray_of(&rays[9 * i], &rays[9 * i + 3], std::numeric_limits<float>::infinity());
        query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        rtcIntersect1(scene, &context, &query);
        if (query.hit.geomID != RTC_INVALID_GEOMETRY_ID) {
          hits++;
          sum += query.ray.tfar;
        }
      }
    } else {
      for (size_t i = 0; i < counts[1]; i++) {
        RTCRay ray = ray_of(&rays[9 * i], &rays[9 * i + 6], 1.0f - 1e-4f);
        rtcOccluded1(scene, &context, &ray);
        hits += ray.tfar < 0;
      }
    }
    double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::cout.precision(17);
    std::cout << seconds << " " << hits << " " << sum << std::endl;
  }
  rtcReleaseGeometry(geometry);
  rtcReleaseScene(scene);
  rtcReleaseDevice(device);
}
