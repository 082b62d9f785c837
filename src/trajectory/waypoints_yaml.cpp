#include "odmc/trajectory/waypoints_yaml.h"

#include "../io/text_file.h"
#include "../io/yaml_reader.h"

namespace odmc {
namespace {

// Visitor that reads the keys that are there and remembers all that may be.
struct NumberReader {
  const YamlValue& value;
  std::vector<std::string> keys;

  void Field(const char* key, double* number) {
    keys.push_back(key);
    if (const auto given = value.Find(key)) *number = given->Number();
  }
};

FlightLimits ReadLimits(const YamlValue& value) {
  FlightLimits limits;
  NumberReader reader{value, {}};
  limits.Visit(&reader);
  value.AllowKeys(reader.keys);
  std::string error;
  if (!limits.IsValid(&error)) value.Fail(error);
  return limits;
}

Waypoint ReadWaypoint(const YamlValue& value) {
  value.AllowKeys({"position_m", "yaw_rad"});
  Waypoint waypoint = {value.Get("position_m").Vector3(), {}};
  if (const auto yaw = value.Find("yaw_rad")) waypoint.yaw = yaw->Number();
  return waypoint;
}

std::vector<Waypoint> ReadWaypoints(const YamlValue& value) {
  std::vector<Waypoint> waypoints;
  for (const YamlValue& item : value.Items()) waypoints.push_back(ReadWaypoint(item));
  std::string error;
  if (!AreFlyable(waypoints, &error)) value.Fail(error);
  return waypoints;
}

}  // namespace

WaypointFile ParseWaypoints(const std::string& text, const std::string& file) {
  const YamlValue root = YamlValue::Parse(text, file);
  root.AllowKeys({"waypoints", "limits"});
  WaypointFile plan;
  plan.waypoints = ReadWaypoints(root.Get("waypoints"));
  if (const auto limits = root.Find("limits")) plan.limits = ReadLimits(*limits);
  return plan;
}

WaypointFile LoadWaypoints(const std::string& file) { return ParseWaypoints(ReadText(file), file); }

}  // namespace odmc
