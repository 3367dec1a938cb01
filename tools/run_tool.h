// What every command does before and after its own work.
#pragma once

namespace ff::tools {

// Runs `run` and returns its exit code. Standard files that are closed are opened first, so that no file that is opened later is taken for one
// of them; where stdout is, writing to it fails. What was not written to stdout, and what is thrown, is one line on stderr and exit code 2.
int runTool(const char* name, int argc, char** argv, int (*run)(int argc, char** argv));

}  // namespace ff::tools
