#include "tests/eval/launch/slurm_cluster.h"

#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

int FreePort() {
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in place{};
  place.sin_family = AF_INET;
  place.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(place);
  if (bind(fd, reinterpret_cast<sockaddr*>(&place), size) == 0)
    getsockname(fd, reinterpret_cast<sockaddr*>(&place), &size);
  close(fd);
  return ntohs(place.sin_port);
}

std::string ShortHostName() {
  char name[256] = "";
  gethostname(name, sizeof(name) - 1);
  const std::string text = name;
  return text.substr(0, text.find('.'));
}

}  // namespace

std::string SlurmCluster::WhyNot() {
  if (geteuid() != 0) return "slurmctld and slurmd are started as root";
  for (const char* program :
       {"/usr/sbin/munged", "/usr/sbin/slurmctld", "/usr/sbin/slurmd", "/usr/bin/sbatch"}) {
    if (access(program, X_OK) != 0)
      return absl::StrCat(program, " is not installed (Debian packages slurm-wlm and munge)");
  }
  return "";
}

absl::StatusOr<std::unique_ptr<SlurmCluster>> SlurmCluster::Start(const std::string& folder) {
  std::unique_ptr<SlurmCluster> cluster(new SlurmCluster(folder));
  RS_RETURN_IF_ERROR(cluster->Launch());
  return cluster;
}

absl::Status SlurmCluster::Launch() {
  for (const char* part : {"", "/state", "/spool"})
    RS_RETURN_IF_ERROR(MakeDirectories(folder_ + part));
  const std::string node = ShortHostName(), socket = folder_ + "/munge.socket";
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder_ + "/munge.key", std::string(64, 'k')));
  RunProgram("chmod", absl::StrCat("600 '", folder_, "/munge.key'"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(
      folder_ + "/slurm.conf",
      absl::StrCat(
          "ClusterName=test\nSlurmctldHost=", node,
          "(127.0.0.1)\nSlurmUser=root\nSlurmdUser=root\n", "AuthType=auth/munge\nAuthInfo=socket=",
          socket, ",cred_expire=5\nCryptoType=crypto/munge\n",
          "MpiDefault=none\nProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\n"
          "SelectType=select/cons_tres\nSelectTypeParameters=CR_Core\nSchedulerType=sched/"
          "backfill\n"
          "SchedulerParameters=sched_interval=2,bf_interval=2\nReturnToService=2\nKillWait=2\n"
          "PreemptType=preempt/partition_prio\nPreemptMode=REQUEUE\n"
          "SlurmdParameters=config_overrides\nStateSaveLocation=",
          folder_, "/state\nSlurmdSpoolDir=", folder_, "/spool\nSlurmctldPidFile=", folder_,
          "/slurmctld.pid\nSlurmdPidFile=", folder_,
          "/slurmd.pid\nAccountingStorageType=accounting_storage/none\n"
          "JobAcctGatherType=jobacct_gather/none\nSlurmctldPort=",
          FreePort(), "\nSlurmdPort=", FreePort(), "\nNodeName=", node,
          " NodeAddr=127.0.0.1 CPUs=4 State=UNKNOWN\n"
          "PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP PriorityTier=1\n"
          "PartitionName=urgent Nodes=ALL MaxTime=INFINITE State=UP PriorityTier=9\n")));
  const std::string conf = folder_ + "/slurm.conf";
  const std::vector<std::vector<std::string>> commands = {
      {"/usr/sbin/munged", "--foreground", "--force", "--num-threads=2", "--socket=" + socket,
       "--key-file=" + folder_ + "/munge.key", "--pid-file=" + folder_ + "/munge.pid",
       "--log-file=" + folder_ + "/munge.log", "--seed-file=" + folder_ + "/munge.seed"},
      {"/usr/sbin/slurmctld", "-D", "-c", "-f", conf},
      {"/usr/sbin/slurmd", "-D", "-c", "-f", conf, "-N", node}};
  for (const std::vector<std::string>& command : commands) {
    RS_ASSIGN_OR_RETURN(ChildProcess daemon,
                        ChildProcess::Start(command, {}, folder_ + "/daemons.log"));
    daemons_.push_back(std::move(daemon));
    while (daemons_.size() == 1 && access(socket.c_str(), F_OK) != 0 && !daemons_[0].Poll())
      poll(nullptr, 0, 20);
  }
  constexpr int kTries = 600;
  for (int i = 0; i < kTries; ++i) {
    // "idle*" is a node that does not answer yet.
    if (absl::StrContains(Run("sinfo --noheader --format=%t --partition=main"), "idle\n"))
      return RunsAJob();
    for (ChildProcess& daemon : daemons_) {
      if (daemon.Poll()) i = kTries;
    }
    poll(nullptr, 0, 200);
  }
  return absl::UnavailableError(
      absl::StrCat("its daemons do not come up here:\n", LastLines(folder_ + "/daemons.log", 30)));
}

// Daemons that answer are not enough: some places let no job start.
absl::Status SlurmCluster::RunsAJob() const {
  const std::string proof = folder_ + "/proof";
  const std::string said =
      Run("timeout 120 sbatch --wait --output=/dev/null --wrap 'touch " + proof + "'");
  if (access(proof.c_str(), F_OK) == 0) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("it starts no job here: ", said, "\n", LastLines(folder_ + "/daemons.log", 30)));
}

SlurmCluster::~SlurmCluster() {
  Run("scancel --user=root");
  for (auto daemon = daemons_.rbegin(); daemon != daemons_.rend(); ++daemon) {
    if (daemon + 1 != daemons_.rend()) {
      for (int i = 0; i < 50 && !Run("squeue --noheader").empty(); ++i) poll(nullptr, 0, 200);
    }
    daemon->Terminate(5000);
  }
}

std::string SlurmCluster::Environment() const {
  return absl::StrCat("SLURM_CONF='", folder_, "/slurm.conf'");
}

std::string SlurmCluster::Run(const std::string& command) const {
  return RunProgram(absl::StrCat("env ", Environment()), command).first;
}

}  // namespace robostress
