// A streamer that works on a thread of its own, so that a frame only hands over where its observers are and takes up a list that is ready.
#pragma once
#include <memory>

#include "stream/streamer.h"

namespace ff::stream {

// What update() brings is of the observers of the call before; who goes farther at once than patches are wanted is pending until that place was looked at.
// `of` is nobody else's. Returns `of` itself where the system has no thread.
std::unique_ptr<Streamer> inBackground(std::unique_ptr<Streamer> of);

}  // namespace ff::stream
