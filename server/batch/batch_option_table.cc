#include "server/batch/batch_option_table.h"

#include <array>

namespace strata::server {
namespace {

constexpr const char* kModels = "Which models";
constexpr const char* kPlaces = "What comes out";
constexpr const char* kRun = "How it runs (none of these changes a sample)";

constexpr std::array kBatchOptions = {
    BatchOption{"--list", "FILE", kModels,
                "Only the models that this file names, one a line, below REPO;\n"
                "- is standard input. Default: all that REPO holds."},
    BatchOption{"--null", nullptr, kModels,
                "The names in --list end with a NUL instead of a line end, as\n"
                "`find -print0` writes them."},
    BatchOption{"--include", "GLOB", kModels,
                "Only models whose path matches; ? * [a-z] ** as in a shell, and\n"
                "without a / against the name alone. May be repeated.",
                true},
    BatchOption{"--exclude", "GLOB", kModels, "No models whose path matches. May be repeated.",
                true},
    BatchOption{"--all", nullptr, kModels,
                "Every file, told by its content. Default: those with the suffix\n"
                "of a mesh, also before .gz or .zst."},
    BatchOption{"--share", "I/N", kModels,
                "The I-th of N shares of the models, I from 0 to N-1, by hash of\n"
                "the path: N processes on as many machines do all. N up to\n"
                "1048576. Default 0/1."},
    BatchOption{"-o,--output", "OUT", kPlaces,
                "The folder of the outputs, which mirrors REPO: a/b.ply becomes\n"
                "OUT/a/b.ply.drc. REPO and OUT may each be s3://BUCKET/PREFIX.\n"
                "Needed."},
    BatchOption{"--pictures", "N", kPlaces,
                "Draws this many of the models for the report, evenly spread.\n"
                "0 to 10000; default 60."},
    BatchOption{"--resume", nullptr, kRun,
                "Leaves alone what a former batch sampled and what has not\n"
                "changed since. The default."},
    BatchOption{"--force", nullptr, kRun, "Samples everything anew."},
    BatchOption{"--prune", nullptr, kRun,
                "Removes the outputs of models that are gone: only outputs that\n"
                "the manifest names."},
    BatchOption{"--jobs", "J", kRun,
                "Models at a time, each with one thread; a large model is alone,\n"
                "with J threads. 1 to 1024; default the processors that this\n"
                "process may use."},
    BatchOption{"--memory", "SIZE", kRun,
                "How much memory all of them use together, at least 192M; fewer\n"
                "at a time where it is short. Default half of what this process\n"
                "may use."},
    BatchOption{"--timeout", "SECONDS", kRun,
                "A model that takes longer fails. 1 to 1000000; default 600."},
    BatchOption{"--scratch", "DIR", kRun,
                "Where to put what does not fit memory.\n"
                "Default the system's directory for temporary files."},
    BatchOption{"--fetch-ahead", "SIZE", kRun,
                "How many bytes of models from a bucket lie on disk at a time,\n"
                "those that wait for their turn included. Default 4G."},
    BatchOption{"--state", "DIR", kRun,
                "Where the state of outputs in a bucket is kept while it runs.\n"
                "Default a folder for OUT below $XDG_CACHE_HOME/strata/batch."},
    BatchOption{"--s3-insecure", nullptr, kRun,
                "Allows AWS_ENDPOINT_URL to be plain http on another machine."},
    BatchOption{"--simd", "TARGET", kRun,
                "Vector instructions, as for `strata sample`. Default auto."},
    BatchOption{"--progress-interval", "SECONDS", kRun,
                "How often a line says how far it is, where standard error is no\n"
                "terminal. 1 to 86400; default 10."},
    BatchOption{"--quiet", nullptr, kRun, "No progress and no summary; failures only."},
};

constexpr const char* kReport = "Options";
constexpr std::array kReportOptions = {
    BatchOption{"--json", nullptr, kReport, "Print JSON instead of text, and write no page."},
    BatchOption{"--html", "FILE", kReport,
                "Where to write the page. Default report.html in the first OUT."},
    BatchOption{"--no-html", nullptr, kReport, "Write no page."},
    BatchOption{"--slowest", "N", kReport,
                "How many of the slowest models are listed. 0 to 10000;\n"
                "default 10."},
    BatchOption{"--s3-insecure", nullptr, kReport,
                "Allows AWS_ENDPOINT_URL to be plain http on another machine."},
};

}  // namespace

std::span<const BatchOption> BatchOptions() { return kBatchOptions; }
std::span<const BatchOption> ReportOptions() { return kReportOptions; }

}  // namespace strata::server
