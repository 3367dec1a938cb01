// Lists of strips that follow each other from frame to frame.
#pragma once
#include <span>
#include <vector>

#include "stream/resident_strip.h"

namespace ff::runtime {

// Makes `list` the same as `now`; both are sorted by tile. What both hold is moved, so that no count changes but those of strips that come and go. spare: empty,
// before and after. Allocates nothing where both have room.
inline void takeOver(std::vector<stream::StripPtr>& list, std::span<const stream::StripPtr> now, std::vector<stream::StripPtr>& spare) {
  auto old = list.begin();
  for (const stream::StripPtr& strip : now) {
    if (old != list.end() && *old != strip)  // one that comes, or after some that went
      while (old != list.end() && (*old)->id < strip->id) ++old;
    const bool stays = old != list.end() && *old == strip;
    spare.push_back(stays ? std::move(*old++) : strip);
  }
  list.swap(spare);
  spare.clear();
}

}  // namespace ff::runtime
